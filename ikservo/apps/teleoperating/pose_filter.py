"""Filter that turns the poses of a hand into joint goals: relative, bounded and without jumps.

::

    pose_filter = PoseFilter(chain, approach_axis, limits)
    q = pose_filter.step(TrackedPose(T_source_hand), q, time_s)     # in each control cycle
    q = pose_filter.step(None, q, time_s)                           # nothing new in this cycle
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ikservo.arguments import check_flag, parse_number
from ikservo.errors import BadValueError, shown
from ikservo.guard.dead_man import DEAD_MAN_TIMEOUT_S
from ikservo.ik import Options, Solver
from ikservo.kinematics import Chain, finite_array
from ikservo.kinematics.arrays import Matrix, Vector, freeze_arrays
from ikservo.kinematics.conditioning import conditioning, ordinary_postures
from ikservo.kinematics.se3 import exp_so3, log_so3, make_pose
from ikservo.motion import KinematicLimits
from ikservo.motion.path import ArmPlane

SMALLEST_SCALE, LARGEST_SCALE = 0.25, 2.0
"""Range of the scale from the motion of the hand to the motion of the tip."""

_ROTATION_ERROR = 1e-3  # largest deviation of R Rᵀ from the identity
# A hand is slower than this, so a larger change between two poses is an error of the tracker.
_JUMP_M, _JUMP_M_S = 0.02, 3.0
_JUMP_RAD, _JUMP_RAD_S = 0.5, 10.0
# Orientations that are further away than this are not followed: the shortest way to them may
# change to the other side.
_MAX_TURN_RAD = 2.0
_IN_PLANE = 0.3  # length of a direction's part in the arm's plane below which it has none
MAX_CYCLE_S = 0.05
"""Longest time between two steps for which a goal moves [s]; a longer time is cut to this."""

TABLE = "the table"
"""Name of the table in the pair of a ``CollisionError``."""

LAG_S = 0.03
"""Delay of a joint behind its goal because of cycles and servos [s]."""

_SINGULAR_M_RAD = 0.04  # the slowest motion of the tip per radian below which the goal slows down
_SLOWEST = 0.2  # fraction of the speed in a singular posture
_LIFT_M = 0.001  # between two goals that are refused because of the table
_MAX_LIFT_M = 0.01  # above the first of them
_SINK_M_RAD = 0.01  # by which the floor sinks again while the arm moves
_REACHED_M = 2e-3
_FAR_M = 0.1  # a target further away counts as this
_TURN_WEIGHT_M_RAD = 0.01  # 1 mm of the position counts like 6° of the orientation
_MIN_PERIOD_S, _MAX_PERIOD_S = 0.01, 0.1  # between two poses; of a longer pause this counts
_LATE = 2.0  # periods without a pose after which the goal stays, at most the longest period
_MEMORY_S = 0.035  # time constant of the estimate of the hand
_SPEED_MEMORY_S = 0.05  # time constant of the speed of the joints


@dataclass(frozen=True, slots=True, eq=False)
class TrackedPose:
    """A pose of a hand or tracker.

    Attributes:
        pose: The pose T_source_hand (4, 4), metres. The axes of the source are parallel to the
            axes of the arm's base frame; its origin may be anywhere.
        held: Whether the clutch is closed; the arm moves with the hand only while it is closed.
        opening: The opening of the gripper, from 0 (closed) to 1 (open); None: no change.

    Raises:
        InputError: A number is not finite, or the orientation is not a rotation.
    """

    pose: ArrayLike
    held: bool = True
    opening: float | None = None

    def __post_init__(self) -> None:
        T = finite_array(self.pose, (4, 4), "The tracked pose")
        R = T[:3, :3]
        if np.abs(R @ R.T - np.eye(3)).max() > _ROTATION_ERROR or np.linalg.det(R) < 0.0:
            raise BadValueError(
                "The rotation of the tracked pose", "invalid", "R Rᵀ = 1, det R = 1"
            )
        check_flag("held", self.held)
        if self.opening is not None and not 0.0 <= parse_number("opening", self.opening) <= 1.0:
            raise BadValueError("opening", shown(self.opening), "a number from 0 to 1")
        u, _, vt = np.linalg.svd(R)  # the nearest rotation: a source rounds its numbers
        object.__setattr__(self, "pose", make_pose(T[:3, 3], u @ vt))
        freeze_arrays(self)

    @property
    def matrix(self) -> Matrix:
        """The pose T_source_hand (4, 4) as an array."""
        return np.asarray(self.pose)


class _HandEstimate:
    """Estimator of a hand's pose and velocity from noisy samples (fading memory filter).

    Args:
        tracked: The first pose.
        time_s: The time of the first pose.
    """

    def __init__(self, tracked: TrackedPose, time_s: float) -> None:
        self.T = self.last = tracked.matrix
        self.time_s, self._period_s = time_s, _MIN_PERIOD_S
        self._velocity_m_s, self._turn_rad_s = np.zeros(3), np.zeros(3)

    def has_jumped(self, tracked: TrackedPose, time_s: float) -> bool:
        """Check whether a pose is further from the last pose than a hand can move in that time."""
        since_s = min(time_s - self.time_s, _MAX_PERIOD_S)
        distance_m = float(np.linalg.norm(tracked.matrix[:3, 3] - self.last[:3, 3]))
        angle_rad = float(np.linalg.norm(log_so3(tracked.matrix[:3, :3] @ self.last[:3, :3].T)))
        return (
            distance_m > _JUMP_M + _JUMP_M_S * since_s
            or angle_rad > _JUMP_RAD + _JUMP_RAD_S * since_s
        )

    def update(self, tracked: TrackedPose, time_s: float) -> None:
        """Update the estimate with the next pose."""
        self._period_s = min(max(time_s - self.time_s, _MIN_PERIOD_S), _MAX_PERIOD_S)
        predicted = self.predict(time_s, 0.0)
        kept = math.exp(-self._period_s / _MEMORY_S)
        shift_m = tracked.matrix[:3, 3] - predicted[:3, 3]
        turn_rad = log_so3(tracked.matrix[:3, :3] @ predicted[:3, :3].T)
        self.T = make_pose(
            predicted[:3, 3] + (1.0 - kept**2) * shift_m,
            exp_so3((1.0 - kept**2) * turn_rad) @ predicted[:3, :3],
        )
        gain = (1.0 - kept) ** 2 / self._period_s
        self._velocity_m_s = self._velocity_m_s + gain * shift_m
        self._turn_rad_s = self._turn_rad_s + gain * turn_rad
        self.time_s, self.last = time_s, tracked.matrix

    def is_late(self, time_s: float) -> bool:
        """Check whether the next pose should have arrived."""
        return time_s - self.time_s > min(_LATE * self._period_s, _MAX_PERIOD_S)

    def predict(self, time_s: float, lead_s: float) -> Matrix:
        """Compute the pose (4, 4) at a time plus a lead, at most until the next pose is due."""
        ahead_s = min(max(time_s - self.time_s, 0.0), self._period_s) + lead_s
        return make_pose(
            self.T[:3, 3] + ahead_s * self._velocity_m_s,
            exp_so3(ahead_s * self._turn_rad_s) @ self.T[:3, :3],
        )


class PoseFilter:
    """Control of the chain's goal by a hand, while the clutch is closed.

    When the clutch closes, the poses of hand and tip are latched; from then on the tip repeats the
    motion of the hand relative to them, so nothing moves at that moment. A pose that a hand cannot
    have reached since the last one is an error of the tracker: the references are latched again.

    Position and orientation are weighted: 1 mm counts like 6°. Arms with four or five joints can
    turn their tool only within the plane of the arm: the direction of the tool is the wanted one,
    projected to this plane, and the roll about it is that of the hand (swing and twist). The goal
    never moves faster than the joints can, and it moves more slowly near singular postures.

    Args:
        chain: The arm, with its own limits.
        approach_axis: The tool axis (3,), in the coordinates of the tip.
        limits: The kinematic limits of each joint.
        scale: The scale from the motion of the hand to the motion of the tip, 0.25 to 2.

    Attributes:
        wanted: The wanted pose T_base_tip (4, 4); None while the clutch is open.
        limit: Reason why the goal is not at the wanted pose: a joint at its limit, ``reach``,
            ``singular``, ``speed``, ``turn``, ``the table`` or ``jump``; empty if it is there.
        is_out_of_reach: Whether the wanted position is out of reach.

    Raises:
        BadValueError: The scale is out of its range.
    """

    def __init__(
        self,
        chain: Chain,
        approach_axis: Vector,
        limits: Sequence[KinematicLimits],
        scale: float = 1.0,
    ) -> None:
        self._chain, self._axis = chain, approach_axis
        self._speeds = np.array([limit.speed_rad_s for limit in limits])
        self._accelerations = np.array([limit.acceleration_rad_s2 for limit in limits])
        self.scale = scale
        self._plane = ArmPlane(chain)
        q = chain.mid_range()
        J = chain.jacobian(q)
        self._normal: Vector = self._plane.rotation(q).T @ J[3:, min(1, chain.dof - 1)]
        mobility = conditioning(chain, ordinary_postures(chain.dof)[0])
        self._moves = len(mobility.moves_m_rad)
        self._rolls = len(mobility.turns_rad_rad) > 1
        # At the edge of the reach, a strict priority of the position would turn the tool for a
        # fraction of a millimetre, and stretch the arm until it could bend to either side.
        options = Options(position_first=False, turn_weight_m_rad=_TURN_WEIGHT_M_RAD)
        self._solver = Solver(chain, "pose", options=options)
        self._hand: _HandEstimate | None = None  # None while the clutch is open
        self._latched: tuple[Matrix, Matrix] = np.eye(4), np.eye(4)  # T_source_hand, T_base_tip
        self._turn: Matrix = np.eye(3)  # the last wanted orientation that is followed
        self._solution = self._speed_rad_s = np.zeros(chain.dof)
        self._stepped_s = -math.inf
        self.wanted: Matrix | None = None
        self.limit, self.is_out_of_reach = "", False

    @property
    def scale(self) -> float:
        """The scale from the hand's motion to the tip's motion; a change opens the clutch."""
        return self._scale

    @scale.setter
    def scale(self, scale: float) -> None:
        if not SMALLEST_SCALE <= parse_number("The scale", scale) <= LARGEST_SCALE:
            expected = f"a number from {SMALLEST_SCALE} to {LARGEST_SCALE}"
            raise BadValueError("The scale", shown(scale), expected)
        self._scale = float(scale)
        self.release()

    def release(self) -> None:
        """Open the clutch; the next pose latches the references again."""
        self._hand = self.wanted = None
        self._floor_m = -math.inf  # the tip stays above it until the hand is higher
        self._touched_m = math.inf  # lowest height of the tip when a goal touched the table

    def on_rejected(self, pair: Sequence[str], kept: Vector) -> None:
        """Slide along the table if a goal was refused because it would touch the table.

        Args:
            pair: The parts that would touch, see ``CollisionError``; empty without a contact.
            kept: The last goal (dof,) that was accepted, from which the next step must start.
        """
        if TABLE in pair:
            kept_m = float(self._chain.forward(kept)[2, 3])
            self._touched_m = min(self._touched_m, kept_m)
            lifted_m = max(self._floor_m, kept_m) + _LIFT_M
            self._floor_m = min(lifted_m, self._touched_m + _MAX_LIFT_M)

    def step(self, tracked: TrackedPose | None, q: Vector, time_s: float) -> Vector:
        """Return the next goal (dof,) of the chain; its difference from the last one is bounded.

        Args:
            tracked: The newest pose, or None if there is none since the last call.
            q: The last accepted goal (dof,).
            time_s: The present time.
        """
        elapsed_s = min(max(time_s - self._stepped_s, 0.0), MAX_CYCLE_S)
        self._stepped_s, self.limit, self.is_out_of_reach = time_s, "", False
        if self._hand is not None and time_s - self._hand.time_s > DEAD_MAN_TIMEOUT_S:
            self.release()
        if tracked is not None:
            self._take(tracked, q, time_s)
        if self._hand is None or self._hand.is_late(time_s):
            return q
        # The arm can stop at every goal, so it is behind a moving one by its braking distance.
        braking_s = np.abs(self._speed_rad_s) / self._accelerations
        lead_s = LAG_S + 0.5 * float(braking_s.max(initial=0.0))
        self.wanted = self._tip_pose(self._hand.predict(time_s, 0.0))
        ahead = self._tip_pose(self._hand.predict(time_s, lead_s))
        if self.wanted[2, 3] > self._floor_m:
            self._floor_m, self._touched_m = -math.inf, math.inf
        elif ahead[2, 3] < self._floor_m:
            ahead[2, 3], self.limit = self._floor_m, self.limit or TABLE
        moved = self._approach(ahead, q, elapsed_s)
        if elapsed_s > 0.0:
            weight = 1.0 - math.exp(-elapsed_s / _SPEED_MEMORY_S)
            self._speed_rad_s += weight * ((moved - q) / elapsed_s - self._speed_rad_s)
        self._floor_m -= _SINK_M_RAD * float(np.abs(moved - q).max())
        return moved

    def _tip_pose(self, T_hand: Matrix) -> Matrix:
        """Compute the wanted pose of the tip (4, 4) for a pose of the hand."""
        hand, tip = self._latched
        return make_pose(
            tip[:3, 3] + self._scale * (T_hand[:3, 3] - hand[:3, 3]),
            T_hand[:3, :3] @ hand[:3, :3].T @ tip[:3, :3],
        )

    def _take(self, tracked: TrackedPose, q: Vector, time_s: float) -> None:
        """Close or open the clutch; latch the references again if the pose has jumped."""
        if not tracked.held:
            self.release()
        elif self._hand is None or self._hand.has_jumped(tracked, time_s):
            self.limit = "" if self._hand is None else "jump"
            T = self._chain.forward(q)
            self._hand, self._latched = _HandEstimate(tracked, time_s), (tracked.matrix, T)
            self._turn, self._solution = T[:3, :3], q
            self._speed_rad_s = np.zeros(self._chain.dof)
        else:
            self._hand.update(tracked, time_s)

    def _approach(self, wanted: Matrix, q: Vector, elapsed_s: float) -> Vector:
        """Return the goal (dof,) after a step from q (dof,) towards a pose (4, 4)."""
        before = self._solution  # not q, which may lag: the solver continues its own branch
        T = self._chain.forward(before)
        R = T[:3, :3]
        turned = self._reachable(wanted[:3, :3], before, R)
        if turned is not None and np.linalg.norm(log_so3(turned @ R.T)) <= _MAX_TURN_RAD:
            self._turn = wanted[:3, :3]
        else:
            self.limit = self.limit or "turn"
            turned = self._reachable(self._turn, before, R)
        # A target far out of reach would count more than the orientation.
        shift_m = wanted[:3, 3] - T[:3, 3]
        shift_m *= min(1.0, _FAR_M / max(float(np.linalg.norm(shift_m)), _FAR_M))
        target = make_pose(T[:3, 3] + shift_m, R if turned is None else turned)
        self._solution, _ = self._solver.track(target, before)
        self.is_out_of_reach = self._solver.result.position_error_m > _REACHED_M
        return self._bounded(self._solution, q, elapsed_s)

    def _reachable(self, R_wanted: Matrix, q: Vector, R: Matrix) -> Matrix | None:
        """Return the attainable orientation (3, 3) at q (dof,) that is nearest to the wanted one.

        Return None if the wanted direction is perpendicular to the plane of the arm.
        """
        if not self._plane.rotates:
            return R_wanted
        wanted, normal = R_wanted @ self._axis, self._plane.rotation(q) @ self._normal
        along = wanted - normal * float(normal @ wanted)
        length = float(np.linalg.norm(along))
        if length < _IN_PLANE:
            return None
        if self._rolls:
            return _swing(wanted, along / length) @ R_wanted
        return _swing(R @ self._axis, along / length) @ R

    def _bounded(self, found: Vector, q: Vector, elapsed_s: float) -> Vector:
        """Return the part (dof,) of a step that the joints can make in the elapsed time."""
        sizes = np.linalg.svd(self._chain.jacobian(q)[:3], compute_uv=False)
        slowest_m_rad = float(sizes[self._moves - 1])  # smallest motion of the tip per radian
        slowing = min(1.0, max(_SLOWEST, slowest_m_rad / _SINGULAR_M_RAD))
        most = self._speeds * (elapsed_s * slowing)
        step = found - q
        excess = float((np.abs(step) / np.maximum(most, 1e-12)).max(initial=0.0))
        solved = self._solver.result
        if excess > 1.0:
            step = step / excess
            self.limit = self.limit or ("singular" if slowing < 1.0 else "speed")
        if solved.binding and not solved.reached:
            self.limit = f"{solved.binding[0].joint} at its limit"
        elif self.is_out_of_reach:
            self.limit = "reach"
        return self._chain.clip(q + step)


def _swing(start: Vector, end: Vector) -> Matrix:
    """Compute the smallest rotation (3, 3) from one unit vector to another."""
    axis = np.cross(start, end)
    length = float(np.linalg.norm(axis))
    if length < 1e-12:
        return np.eye(3)
    return exp_so3(axis * (math.atan2(length, float(start @ end)) / length))
