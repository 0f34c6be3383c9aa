"""What is known of a person's arm without its servos: the arm file, and its newest calibration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ikservo.arm.calibrating.belonging import check_belongs
from ikservo.arm.own import calibrated_limits, geometry_of
from ikservo.calibration.filing.calibration_file import read_calibration
from ikservo.calibration.filing.record import Calibration
from ikservo.calibration.filing.store import calibrations_of
from ikservo.kinematics import Chain
from ikservo.kinematics.geometry import corrected
from ikservo.model import Model, ModelJoint, load_model

__all__ = ["Known", "known"]


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """An arm as its files know it.

    Attributes:
        model: With this arm's links, its chain and joints inside this arm's ranges.
        file: The calibration these come from; None where the arm file is all there is.
        others: Older calibrations of arms of this kind, on other adapters.
    """

    model: Model
    file: Path | None = None
    others: tuple[Path, ...] = ()


def known(model: Model) -> Known:
    """Read the calibrations of an arm and return it inside the newest; nothing is asked of a bus.

    A bare URDF has no servos, and therefore no calibration.

    Raises:
        FileFormatError: A calibration is spoiled.
        CalibrationError: The newest is of other servos or another chain than the arm file's, or
            leaves a joint no range.
    """
    read = {path: read_calibration(path) for path in calibrations_of(model.name) if model.joints}
    if not read:
        return Known(model)
    newest = max(read, key=lambda path: read[path].written)
    calibration = read[newest]
    # The way to its own tip tells the arm from others, whatever link is asked about.
    check_belongs(calibration, load_model(model.path), calibration.usb_serial_number)
    others = tuple(path for path in read if path != newest)
    return Known(_calibrated(model, calibration), newest, others)


def _calibrated(model: Model, calibration: Calibration) -> Model:
    filed = calibration.geometry
    chain = corrected(model.chain, geometry_of(filed)) if filed else model.chain
    joints = [_narrowed(joint, calibration) for joint in model.joints]
    return replace(model, chain=_inside(chain, joints), joints=tuple(joints))


def _narrowed(joint: ModelJoint, calibration: Calibration) -> ModelJoint:
    own = calibration.joint(joint.name)
    return replace(joint, limits=calibrated_limits(calibration, own, joint)) if own else joint


def _inside(chain: Chain, joints: Sequence[ModelJoint]) -> Chain:
    """Return the chain inside the joints' ranges; joints that mimic may have narrowed its own."""
    ranges = {joint.name: joint.limits for joint in joints}
    own = [ranges.get(name) for name in chain.names]
    lower = [-np.inf if limits is None else limits.lower.value for limits in own]
    upper = [np.inf if limits is None else limits.upper.value for limits in own]
    return chain.with_limits(np.maximum(chain.lower_rad, lower), np.minimum(chain.upper_rad, upper))
