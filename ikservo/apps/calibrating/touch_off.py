"""A touch-off session: record touched points, fit and store the geometry."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

import numpy as np

from ikservo.apps.calibrating.calibration_session import TorqueOffArm, load_own_calibration
from ikservo.apps.calibrating.parameter_selection import CalibrationEstimate
from ikservo.apps.calibrating.touch_procedure import TouchOffState, TouchTarget
from ikservo.calibration import JointMap
from ikservo.calibration.calibration_file import save_calibration
from ikservo.calibration.records import (
    CalibratedGeometry,
    CalibratedOrigin,
    Calibration,
    shift_zeros,
)
from ikservo.calibration.servo_config import raise_on_mismatch, register_mismatches
from ikservo.ik import Target, solve
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Vector
from ikservo.planning.calibrated_arm import (
    CalibratedArm,
    ZeroSource,
    bent_chain,
    check_calibration_matches,
)

# A point that the model reaches this closely can be reached by hand despite model errors.
_REACHED_M = 0.01


class TouchOffSession:
    """A calibrated arm with its torque off, ready for a touch-off.

    Attributes:
        loose: The servos of the arm.
        calibration: The calibration file of the arm.
        chain: The chain of the arm file, without the corrections of an earlier touch-off.
        present: The chain with the corrections of an earlier touch-off.
        maps: The conversion from ticks to positions, per joint of the chain.

    Raises:
        CalibrationError: The arm is not calibrated, or the servos contradict the calibration.
        FileFormatError: The calibration is malformed.
    """

    def __init__(self, loose: TorqueOffArm) -> None:
        self.loose, self.calibration = loose, load_own_calibration(loose)
        check_calibration_matches(self.calibration, loose.model, loose.serial_number)
        raise_on_mismatch(register_mismatches(self.calibration, loose.facts))
        self.chain: Chain = bent_chain(loose.model, loose.model.chain, self.calibration)
        own = CalibratedArm(loose.bus, loose.model, ZeroSource.CALIBRATED, self.calibration)
        self.present = own.chain()
        joints = [loose.model.joint(name) for name in self.chain.names]
        self.maps: tuple[JointMap, ...] = tuple(own.joint_map(joint) for joint in joints)

    def start_touch_off(self, targets: Sequence[TouchTarget]) -> TouchOffState:
        """Return the initial state of a touch-off at the given points."""
        return TouchOffState(self.chain, self.present, self.maps, tuple(targets))

    def reachable_targets(self, targets: Sequence[TouchTarget]) -> list[TouchTarget]:
        """Return the targets within reach of the tip."""
        reachable: list[TouchTarget] = []
        for target in targets:
            if target.position_m is not None:
                goal = Target(target.position_m)
                result = solve(self.chain, goal, restarts=10, nearest=False)
                if not result.position_error_m < _REACHED_M:
                    continue
            reachable.append(target)
        return reachable

    def save(self, found: CalibrationEstimate, written: datetime) -> Path:
        """Save the calibration with the result of a touch-off; keep a copy of the previous one.

        Raises:
            FileWriteError: The disk is full or not writable; the old calibration is unchanged.
        """
        return save_calibration(apply_touch_off(self.calibration, self.maps, found, written))


def apply_touch_off(
    calibration: Calibration,
    maps: Sequence[JointMap],
    found: CalibrationEstimate,
    written: datetime,
) -> Calibration:
    """Make a calibration with the zeros and the geometry of a touch-off.

    The new calibration has no camera, because the pose of the camera depended on the old zeros.
    """
    joints = shift_zeros(calibration.joints, maps, found.zeros)
    written = written.replace(microsecond=0)
    geometry = (
        _calibrated_geometry(found, written)
        if found.extent.includes_base or found.extent.includes_links
        else None
    )
    return calibration.model_copy(
        update={"joints": joints, "geometry": geometry, "written": written}
    ).with_cameras({})


def _calibrated_geometry(found: CalibrationEstimate, written: datetime) -> CalibratedGeometry:
    geometry, kept = found.geometry, found.fit.kept
    origins = [
        CalibratedOrigin(joint=name, moved_mm=_round_vector(1000 * move))
        for name, move in geometry.origins_m.items()
    ]
    return CalibratedGeometry(
        touched=written,
        touches=len(kept),
        left_out=int(np.count_nonzero(~kept)),
        before_mm=1000 * found.before_m,
        after_mm=1000 * found.after_m,
        base_moved_mm=_round_vector(1000 * geometry.base_m),
        base_turned_deg=_round_vector(np.degrees(geometry.base_rad)),
        origins=tuple(origins) if found.extent.includes_links else (),
    )


def _round_vector(values: Vector) -> tuple[float, float, float]:
    x, y, z = (round(float(value), 6) for value in values)
    return x, y, z
