"""Find where a limp arm comes to rest, by letting the simulated arm sink."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ikservo.arm.arm import Arm
from ikservo.arm.opening import open_own_arm
from ikservo.control.stillness import StillnessDetector, read_until_at_rest
from ikservo.kinematics.arrays import Matrix
from ikservo.model.model_loading import load_model

_MIN_S, _MAX_S = 4.0, 60.0  # shortest and longest simulation
# A sinking arm moves by more than this in a second, rad or m.
_LIES = StillnessDetector(window_s=1.0, tolerance=0.001, least_readings=2)
_ROOM_M = 0.006  # clearance of the sagging arm, whose path down is not straight
_MAX_SHARE = 0.4  # largest fraction of the path back to the start that the result may be raised
_SHARES = 201  # fractions of the path that are tried


@dataclass(frozen=True, slots=True)
class RestingPlace:
    """The posture in which a limp arm comes to rest.

    Attributes:
        positions: Positions by joint, rad or m, a little above the first contact that the guard
            would report.
        sank_s: The time that the arm needed to sink.
        gap_m: The smallest distance between its parts, as the guard measures it; negative if
            shapes overlap.
        pair: The two parts with that distance; empty if collisions are not checked.
        still: Whether the arm came to rest.
    """

    positions: dict[str, float]
    sank_s: float
    gap_m: float
    pair: tuple[str, ...]
    still: bool


def find_resting_place(folder: Path, pose: str = "home") -> RestingPlace:
    """Release a simulated arm in a pose, and wait until it lies still, at most a minute.

    Raises:
        IkservoError: The arm cannot be simulated.
    """
    with open_own_arm(load_model(folder), f"sim:?pose={pose}", uncalibrated=True) as arm:
        limits = {joint.name: joint.limits for joint in arm.model.joints}
        released_s = arm.clock.now_s()

        def lies(still: StillnessDetector) -> bool:
            return still.is_at_rest() and still.readings[-1][0] - released_s >= _MIN_S

        def read() -> Iterable[float]:
            return arm.where().positions.values()

        still = read_until_at_rest(_LIES, read, arm.clock, _MAX_S, lies)
        sank_s = still.readings[-1][0] - released_s
        inside = {
            name: float(np.clip(at, limits[name].lower.value, limits[name].upper.value))
            for name, at in zip(arm.joint_index.names, still.joints, strict=True)
        }
        free = _free_above(arm, inside, arm.model.pose(pose))
        gap_m, pair = math.inf, tuple[str, ...]()
        checker = arm.context.checked_collision
        if checker is not None:
            gaps_m = checker.distances(_body_joints(arm, free))[0]
            nearest = int(gaps_m.argmin())
            gap_m, pair = float(gaps_m[nearest]), checker.pairs[nearest]
        return RestingPlace(free, sank_s, gap_m, pair, still.is_at_rest())


def _free_above(
    arm: Arm, resting: Mapping[str, float], start: Mapping[str, float]
) -> dict[str, float]:
    """Return the lowest free posture on the straight path from the start to the resting posture.

    A limp arm lies on its own parts, but the guard uses shapes that are a little thicker.
    If the path is blocked far above the resting posture, the resting posture itself is returned.
    """
    found: dict[str, float] | None = None
    room_m = min(_ROOM_M, 0.8 * _sagged_clearance_m(arm, start))
    for share in np.linspace(1.0, 0.0, _SHARES).tolist():
        raised = {name: at + share * (start[name] - at) for name, at in resting.items()}
        if _sagged_clearance_m(arm, raised) < room_m:
            break
        if share <= _MAX_SHARE:
            found = raised
    return found or dict(resting)


def _sagged_clearance_m(arm: Arm, positions: Mapping[str, float]) -> float:
    """Compute the clearance [m] that the guard finds if an arm moves through a posture."""
    checker = arm.context.checked_collision
    if checker is None:
        return math.inf
    load = arm.context.planner.dynamic_load_factor("normal")  # a moving arm sags more than at rest
    return float(checker.distances_with_sag(_body_joints(arm, positions), load).min())


def _body_joints(arm: Arm, positions: Mapping[str, float]) -> Matrix:
    """Return the joint vector (1, n) of a posture, as the guard uses it."""
    joints = np.array([positions[name] for name in arm.context.servos.names])
    return arm.context.index.body_joints(joints)[None]
