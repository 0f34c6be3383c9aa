"""A limp arm whose tip is put on points, and the calibration that follows from it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

import numpy as np

from ikservo.arm.calibrating.belonging import check_belongs
from ikservo.arm.calibrating.by_hand import LooseArm
from ikservo.arm.calibrating.filing import own_calibration
from ikservo.arm.own import OwnArm
from ikservo.arm.trust import Zeros
from ikservo.calibration import JointMap
from ikservo.calibration.filing.record import (
    CalibratedGeometry,
    CalibratedJoint,
    CalibratedOrigin,
    Calibration,
)
from ikservo.calibration.filing.store import save
from ikservo.calibration.in_servos.compare import contradictions_with, refuse
from ikservo.ik import Target, solve
from ikservo.kinematics import Chain
from ikservo.kinematics.geometry import Geometry
from ikservo.kinematics.se3 import Vector
from ikservo.model.touch import Estimate
from ikservo.model.touch.conversation import Touching
from ikservo.model.touch.grid import Place

__all__ = ["TouchArm", "touched"]

# What is closer than that to a point can be guided there, for all the errors there may be.
_REACHED_M = 0.01


class TouchArm:
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

    def __init__(self, loose: LooseArm) -> None:
        self.loose, self.calibration = loose, own_calibration(loose)
        check_belongs(self.calibration, loose.model, loose.serial_number)
        refuse(contradictions_with(self.calibration, loose.facts))
        self.chain: Chain = loose.model.chain
        own = OwnArm(loose.bus, loose.model, Zeros.CALIBRATED, self.calibration)
        self.present = own.chain()
        joints = [loose.model.joint(name) for name in self.chain.names]
        self.maps: tuple[JointMap, ...] = tuple(own.joint_map(joint) for joint in joints)

    def begin(self, places: Sequence[Place]) -> Touching:
        """Return the conversation over some points."""
        return Touching.begin(self.chain, self.present, self.maps, places)

    def within_reach(self, places: Sequence[Place]) -> list[Place]:
        """Return the places that the tip can be put on."""
        return [place for place in places if self._reaches(place.position_m)]

    def save(self, found: Estimate, written: datetime) -> Path:
        """Write the calibration with what a touch-off found; the one before is kept beside it.

        Raises:
            FileWriteError: The disk will not take it; the one before still stands.
        """
        return save(touched(self.calibration, self.maps, found, written))

    def _reaches(self, position_m: Vector | None) -> bool:
        if position_m is None:
            return True
        answer = solve(self.chain, Target(position_m), restarts=10, nearest=False)
        return answer.position_error_m < _REACHED_M


def touched(
    calibration: Calibration, maps: Sequence[JointMap], found: Estimate, written: datetime
) -> Calibration:
    """Return a calibration with the zeros and the geometry that a touch-off found."""
    moves = {m.joint: float(z) for m, z in zip(maps, found.zeros, strict=True)}
    joints = tuple(_turned(joint, moves, maps) for joint in calibration.joints)
    written = written.replace(microsecond=0)
    geometry = _filed(found, written) if found.extent.base or found.extent.links else None
    return calibration.model_copy(
        update={"joints": joints, "geometry": geometry, "written": written}
    )


def _turned(
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


def _filed(found: Estimate, written: datetime) -> CalibratedGeometry:
    geometry, kept = found.geometry, found.fit.kept
    return CalibratedGeometry(
        touched=written,
        touches=len(kept),
        left_out=int(np.count_nonzero(~kept)),
        before_mm=1000 * found.before_m,
        after_mm=1000 * found.after_m,
        base_moved_mm=_three(1000 * geometry.base_m),
        base_turned_deg=_three(np.degrees(geometry.base_rad)),
        origins=_origins(geometry) if found.extent.links else (),
    )


def _origins(geometry: Geometry) -> tuple[CalibratedOrigin, ...]:
    return tuple(
        CalibratedOrigin(joint=name, moved_mm=_three(1000 * move))
        for name, move in geometry.origins_m.items()
    )


def _three(values: Vector) -> tuple[float, float, float]:
    x, y, z = (round(float(value), 6) for value in values)
    return x, y, z
