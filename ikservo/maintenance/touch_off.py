"""A touch-off session: record touched points, fit and store the geometry."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

import numpy as np

from ikservo.arm.calibrated_arm import (
    CalibratedArm,
    ZeroSource,
    check_calibration_matches,
)
from ikservo.calibration import JointMap
from ikservo.calibration.calibration_file import save_calibration
from ikservo.calibration.records import (
    CalibratedGeometry,
    CalibratedJoint,
    CalibratedOrigin,
    Calibration,
)
from ikservo.calibration.servo_config import raise_on_mismatch, register_mismatches
from ikservo.ik import Target, solve
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Vector
from ikservo.kinematics.geometric_errors import GeometricErrors
from ikservo.maintenance.calibration_session import TorqueOffArm, load_own_calibration
from ikservo.model.parameter_selection import CalibrationEstimate
from ikservo.model.touch_procedure import TouchOffState, TouchTarget

__all__ = ["TouchOffSession", "apply_touch_off"]

# What is closer than that to a point can be guided there, for all the errors there may be.
_REACHED_M = 0.01


class TouchOffSession:
    """A calibrated arm that has been let go, ready for a touch-off.

    Attributes:
        loose: Its servos.
        calibration: What its file says.
        chain: As described: what an earlier touch-off found of its links is found anew.
        present: With what an earlier touch-off found.
        maps: What the ticks of the chain's joints mean.

    Raises:
        CalibrationError: It is not calibrated, or its servos say otherwise.
        FileFormatError: Its calibration is spoiled.
    """

    def __init__(self, loose: TorqueOffArm) -> None:
        self.loose, self.calibration = loose, load_own_calibration(loose)
        check_calibration_matches(self.calibration, loose.model, loose.serial_number)
        raise_on_mismatch(register_mismatches(self.calibration, loose.facts))
        self.chain: Chain = loose.model.chain
        own = CalibratedArm(loose.bus, loose.model, ZeroSource.CALIBRATED, self.calibration)
        self.present = own.chain()
        joints = [loose.model.joint(name) for name in self.chain.names]
        self.maps: tuple[JointMap, ...] = tuple(own.joint_map(joint) for joint in joints)

    def start_touch_off(self, places: Sequence[TouchTarget]) -> TouchOffState:
        """Return the conversation over some points."""
        return TouchOffState.begin(self.chain, self.present, self.maps, places)

    def reachable_targets(self, places: Sequence[TouchTarget]) -> list[TouchTarget]:
        """Return the places that the tip can be put on."""
        return [place for place in places if self._is_reachable(place.position_m)]

    def save(self, found: CalibrationEstimate, written: datetime) -> Path:
        """Write the calibration with what a touch-off found; the one before is kept beside it.

        Raises:
            FileWriteError: The disk will not take it; the one before still stands.
        """
        return save_calibration(apply_touch_off(self.calibration, self.maps, found, written))

    def _is_reachable(self, position_m: Vector | None) -> bool:
        if position_m is None:
            return True
        answer = solve(self.chain, Target(position_m), restarts=10, nearest=False)
        return answer.position_error_m < _REACHED_M


def apply_touch_off(
    calibration: Calibration,
    maps: Sequence[JointMap],
    found: CalibrationEstimate,
    written: datetime,
) -> Calibration:
    """Return a calibration with the zeros and the geometry that a touch-off found."""
    moves = {m.joint: float(z) for m, z in zip(maps, found.zeros, strict=True)}
    joints = tuple(_shift_joint(joint, moves, maps) for joint in calibration.joints)
    written = written.replace(microsecond=0)
    geometry = (
        _calibrated_geometry(found, written)
        if found.extent.includes_base or found.extent.includes_links
        else None
    )
    return calibration.model_copy(
        update={"joints": joints, "geometry": geometry, "written": written}
    )


def _shift_joint(
    joint: CalibratedJoint, moves: dict[str, float], maps: Sequence[JointMap]
) -> CalibratedJoint:
    """Return a joint whose positions all lie ``moves`` further on; its stops stay where they are.

    What the person set is meant in the geometry's own numbers and does not move.
    """
    if joint.name not in moves:
        return joint
    joint_map = next(m for m in maps if m.joint == joint.name)
    move = moves[joint.name]
    ends = {"lower_deg": math.degrees(move), "upper_deg": math.degrees(move)}
    ends |= {"lower_m": move, "upper_m": move}
    shifted = {
        key: getattr(joint, key) + by for key, by in ends.items() if getattr(joint, key) is not None
    }
    ticks = joint_map.sign * move / joint_map.unit_per_tick
    return joint.model_copy(update={"zero_tick": joint.zero_tick - ticks, **shifted})


def _calibrated_geometry(found: CalibrationEstimate, written: datetime) -> CalibratedGeometry:
    geometry, kept = found.geometry, found.fit.kept
    return CalibratedGeometry(
        touched=written,
        touches=len(kept),
        left_out=int(np.count_nonzero(~kept)),
        before_mm=1000 * found.before_m,
        after_mm=1000 * found.after_m,
        base_moved_mm=_round_vector(1000 * geometry.base_m),
        base_turned_deg=_round_vector(np.degrees(geometry.base_rad)),
        origins=_calibrated_origins(geometry) if found.extent.includes_links else (),
    )


def _calibrated_origins(geometry: GeometricErrors) -> tuple[CalibratedOrigin, ...]:
    return tuple(
        CalibratedOrigin(joint=name, moved_mm=_round_vector(1000 * move))
        for name, move in geometry.origins_m.items()
    )


def _round_vector(values: Vector) -> tuple[float, float, float]:
    x, y, z = (round(float(value), 6) for value in values)
    return x, y, z
