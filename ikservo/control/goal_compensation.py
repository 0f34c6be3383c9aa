"""Compute goals that keep joints on their reference: feed-forward, feedback, soft starts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ikservo.control.feed_forward import FeedForward
from ikservo.control.preload import Preload
from ikservo.control.tracking_feedback import TrackingFeedback
from ikservo.guard import DrivenJoint
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.motion import TrajectoryPoint

# docs/how-control-works.md explains how these numbers were chosen.
_FADE_S = 0.2  # the offset at the beginning of a motion fades to the computed offset in this time
_TINY = 1e-9  # speeds below this, in rad/s or m/s, are rounding
# A horn that is further from its reference when a motion begins has sagged or was lifted: friction
# then acts on it in the other direction.
_SAG_RAD = 0.01
_MAX_STEP_S = 0.02  # a late cycle counts as at most this long: goals must not jump after a stall
_DIRECTION_RAD = 0.0005  # at the horn: friction reverses over a multiple of this (Dahl 1968)
_DIRECTION_S = 0.05  # shortest time in which friction reverses, because goals must not jump
# While the reference of a horn rests, errors up to this many ticks are ignored: stiction would make
# the joint jump over its target repeatedly.
_REST_TICKS = 4.5
_AT_REST_RAD_S = 0.003  # at the horn: width of the transition to a resting reference
_MAX_LOAD_OFFSET_RAD = 0.08  # at the horn: largest change of goals by learned load and friction
_LOAD_STEP_RAD = 0.001  # at the horn: step of the load that gives the feed-forward's slope
_SLOPE_RANGE = (0.3, 3.0)  # limits of this slope, which the firmware's start-up force flattens
_INERTIA_PERIOD_S = 0.1  # between updates of the gains: the mass matrix costs time
# Multiples of the dry friction: a joint that carries less than the first may rest anywhere in its
# backlash; a joint that presses by more than the second has crossed its backlash.
_UNLOADED = 1.0
_PUSHED = 0.3
_RATE_FILTER_S = 0.03  # time in which the speed of a motion seems to change when it is slowed down


class GoalCompensator:
    """Converter from the references of an arm's joints to goals for their servos.

    The goal of a joint is its reference plus an offset: the feed-forward, the feedback of the
    joint's error, and, at the beginning of a motion, the difference to the previous offset, which
    fades out. The load learned by feedback is part of the feed-forward, because friction grows with
    it. Only joints of the chain have an offset: a gripper may press on something.

    Args:
        driven_joints: The joints, each with its servo, limits and speed.
        columns: The columns of the chain's joints among these joints.
        feed_forward: The feed-forward of the chain's joints; None if masses or motors are unknown.
    """

    def __init__(
        self,
        driven_joints: Sequence[DrivenJoint],
        columns: Sequence[int] = (),
        feed_forward: FeedForward | None = None,
    ) -> None:
        n = len(driven_joints)
        self.feed_forward = self._nominal = feed_forward
        self._chain = np.isin(np.arange(n), list(columns))
        self._low, self._high = (
            np.array(ends)
            for ends in zip(*(driven.position_range for driven in driven_joints), strict=True)
        )
        self._per_horn_rad = np.array(
            [driven.joint_map.unit_per_horn_rad for driven in driven_joints]
        )
        self._tick = np.array([driven.joint_map.unit_per_tick for driven in driven_joints])
        self._load_step = _LOAD_STEP_RAD * self._per_horn_rad
        self._max_load_offset = _MAX_LOAD_OFFSET_RAD * self._per_horn_rad
        self._reference_range = self._goal_range = (self._low, self._high)
        self._feedback = TrackingFeedback(self._per_horn_rad)
        self._fading = np.zeros(n)
        self._direction: Vector = np.zeros(n)
        self._faded_s, self._rate, self._held_s, self._adapted_s = np.zeros(n), 1.0, 0.0, 0.0
        self._clamped = np.zeros(n, dtype=bool)
        self._preload: Preload | None = None
        self._waits = False
        self._slope, self._is_load_bounded = np.ones(n), np.zeros(n, dtype=bool)
        self._last = TrajectoryPoint.at_rest(np.zeros(n))

    @property
    def corrects(self) -> NDArray[np.bool_]:
        """Mask of the joints (n,) that have an offset."""
        return self._chain

    def start(self, gain_shares: Sequence[float]) -> None:
        """Discard the load and friction that feedback has learned, because torque was off.

        Args:
            gain_shares: P gains of all servos (n,), as fractions of those in ``parameters``.
        """
        self._feedback.reset()
        if self._nominal is not None:
            chain = [gain_shares[column] for column in self._nominal.columns]
            self.feed_forward = self._nominal.with_gains(chain)

    def begin(
        self,
        reference: Vector,
        goals: Vector,
        cycle_time_s: float | None = None,
        measured: Vector | None = None,
    ) -> None:
        """Begin a motion at a reference (n,), while the servos hold at the given goals (n,).

        Each goal is held for ``cycle_time_s`` (None keeps the previous time). Without measured
        positions, the reference is used.
        """
        self._held_s = self._held_s if cycle_time_s is None else cycle_time_s
        self._reference_range, self._goal_range = (
            (np.minimum(self._low, each), np.maximum(self._high, each))
            for each in (reference, goals)
        )
        self._last = TrajectoryPoint.at_rest(reference)
        self._feedback.begin()
        self._adapt_gains(reference)
        offset = sagged = np.where(self._chain, goals - reference, 0.0)
        if measured is not None:
            lag = np.where(self._chain, reference - measured, 0.0)
            sagged = offset + np.where(np.abs(lag) > _SAG_RAD * self._per_horn_rad, lag, 0.0)
        # The direction of a resting joint is the signed fraction of friction that holds it.
        lowest, highest = (self._modelled(self._last, side) for side in (-1.0, 1.0))
        middle, half = 0.5 * (lowest + highest), 0.5 * (highest - lowest)
        share = np.divide(sagged - middle, half, where=half > 0.0, out=np.zeros_like(half))
        self._direction = np.clip(share, -1.0, 1.0)
        self._fading = offset - self._modelled(self._last, self._direction)
        self._faded_s, self._rate = np.zeros_like(reference), 1.0
        self._clamped = np.zeros_like(self._chain)
        self._preload, self._waits = None, False

    def preload(self, ahead: Vector, measured: Vector, elapsed_s: float) -> bool:
        """Press rotors against the driving flanks; return whether the motion may begin.

        The caller repeats this in each cycle until it returns True, and sends goals for the start
        in between. ``ahead`` is the first displacement of the reference (n,), rad or m.
        """
        if self._preload is None:
            sides = np.zeros_like(ahead)
            if self.feed_forward is not None:
                weight = np.full_like(ahead, np.inf)
                columns = list(self.feed_forward.columns)
                weight[columns] = self.feed_forward.weight(self._last.position)
                moves = np.where(np.abs(ahead) > 0.1 * self._tick, np.sign(ahead), 0.0)
                # These are the joints that weight does not press on their driving flanks.
                unloaded = (weight < _UNLOADED) & (moves * self._direction < _PUSHED)
                sides = np.where(unloaded, moves, 0.0)
            self._preload = Preload(sides, measured, self._per_horn_rad, self._tick)
        direction = self._preload.update(measured, self._direction, elapsed_s)
        self._direction = self._direction if direction is None else direction
        self._rate, self._waits = 1.0, direction is not None
        return direction is None

    def stuck_offsets(self, positions: Vector) -> tuple[Vector, Vector]:
        """Compute the offsets (n,) [rad or m] between which friction holds joints (n,) at rest."""
        at_rest = TrajectoryPoint.at_rest(positions)
        low, high = (self._modelled(at_rest, side) for side in (-1.0, 1.0))
        return low, high

    def goals(
        self,
        point: TrajectoryPoint,
        elapsed_s: float,
        rate: float = 1.0,
        ease: Vector | float = 1.0,
    ) -> Vector:
        """Compute the goals (n,) for a reference, inside the limits.

        Args:
            point: The reference (n,), with derivatives with respect to the time of the motion.
            elapsed_s: Time since the last call, by the clock.
            rate: Seconds of the motion per second of the clock.
            ease: The rate at which offsets change (n,), 0 to 1; lower for joints that lag.
        """
        elapsed_s = min(elapsed_s, _MAX_STEP_S)
        self._rate += (rate - self._rate) * min(elapsed_s / _RATE_FILTER_S, 1.0)
        self._last = TrajectoryPoint(
            point.position, point.velocity * self._rate, point.acceleration * self._rate**2
        )
        # Friction turns to the direction of the motion, over a short distance at limited speed.
        turning_s = ease * elapsed_s
        moved = self._last.velocity * turning_s / (_DIRECTION_RAD * self._per_horn_rad)
        change, most = moved - self._direction * np.abs(moved), 2.0 * turning_s / _DIRECTION_S
        self._direction = np.clip(self._direction + np.clip(change, -most, most), -1.0, 1.0)
        self._adapted_s += elapsed_s
        if self._adapted_s >= _INERTIA_PERIOD_S:
            self._adapt_gains(point.position)
        # A joint that stays at rest keeps its offset, as far as friction allows.
        begun = (self._faded_s > 0.0) | (np.abs(self._last.velocity) > _TINY)
        self._faded_s = np.minimum(self._faded_s + begun * ease * elapsed_s, _FADE_S)
        rows = self._feed_forwards(self._last, self._direction)
        nominal, loaded, more = rows
        self._slope = np.clip((more - loaded) / self._load_step, *_SLOPE_RANGE)
        self._is_load_bounded = np.abs(loaded - nominal) >= self._max_load_offset
        lead = 0.0 if self._preload is None else self._preload.lead
        offset = (
            self._offset(rows, self._direction)
            + self._feedback.fast * (1.0 - self._fade_share)
            + (self._fading + lead) * self._fade_share
        )
        return self._inside(point.position, offset)

    def observe(
        self,
        measured: Vector,
        since_s: float,
        elapsed_s: float,
        *,
        fresh: NDArray[np.bool_] | bool = True,
        grow: Vector | float,
    ) -> None:
        """Update the feedback with the error of the joints (n,) relative to the last reference.

        Args:
            measured: The joints.
            since_s: Time from the last goals to the measurement.
            elapsed_s: Time between two measurements.
            fresh: Whether each joint (n,) replied.
            grow: Rate at which feedback may move goals (n,) further away, 0 to 1; 0 for goals that
                were cut or are at a limit.
        """
        if self._waits:  # the feedback does not learn from errors before the motion begins
            return
        last = self._last
        error = np.where(self._chain, last.position + since_s * last.velocity - measured, 0.0)
        moving = np.abs(last.velocity) / (_AT_REST_RAD_S * self._per_horn_rad)
        left = _REST_TICKS * self._tick * np.maximum(1.0 - moving, 0.0)
        preloaded = False if self._preload is None else self._preload.joints
        # Preloaded joints move ahead although their friction is not lower than modelled.
        ahead = preloaded & (self._fade_share > 0.0)
        growing = np.where(self._clamped | self._is_load_bounded, 0.0, grow)
        self._feedback.update(
            error,
            left,
            elapsed_s,
            fresh=fresh,
            grow=growing,
            slope=self._slope,
            direction=np.where((moving > 1.0) & ~ahead, self._direction, 0.0),
        )

    def _adapt_gains(self, positions: Vector) -> None:
        """Adapt the feedback gains to the inertia of the arm in a posture (n,)."""
        self._adapted_s = 0.0
        if self.feed_forward is not None:
            rows = np.zeros((2, len(positions)))
            known = self.feed_forward.inertia_s2(positions), self.feed_forward.pressed(positions)
            rows[:, list(self.feed_forward.columns)] = known
            self._feedback.adapt(*rows)

    @property
    def _fade_share(self) -> Vector:
        share = self._faded_s / _FADE_S
        return 1.0 - share * share * (3.0 - 2.0 * share)

    def _modelled(self, point: TrajectoryPoint, direction: Vector | float) -> Vector:
        """Return the feed-forward (n,) with the load and friction that feedback has learned."""
        return self._offset(self._feed_forwards(point, direction), direction)

    def _offset(self, rows: Matrix, direction: Vector | float) -> Vector:
        """Compute the feed-forward (n,) with bounded load and learned friction."""
        nominal, loaded, _ = rows
        load = np.clip(loaded - nominal, -self._max_load_offset, self._max_load_offset)
        return nominal + load + direction * self._feedback.friction

    def _feed_forwards(self, point: TrajectoryPoint, direction: Vector | float) -> Matrix:
        """Compute the feed-forward (3, n) without load, with load, and with slightly more load."""
        load = self._feedback.integral
        loads = np.stack([np.zeros_like(load), load, load + self._load_step])
        if self.feed_forward is None:
            return loads
        directions = np.broadcast_to(direction, point.position.shape)
        return self.feed_forward.offsets(point, directions, self._held_s, loads)

    def _inside(self, reference: Vector, offset: Vector) -> Vector:
        """Return goals inside the limits, or no further outside than earlier in this motion.

        A reference that leaves the limits is not clamped, so that the guard refuses it.
        """
        low, high = self._reference_range
        leaves = (reference < low - self._tick) | (reference > high + self._tick)
        goals = np.clip(reference + offset, *self._goal_range)
        self._clamped = goals != reference + offset
        self._goal_range = (np.minimum(self._low, goals), np.maximum(self._high, goals))
        return np.where(leaves, reference, goals)
