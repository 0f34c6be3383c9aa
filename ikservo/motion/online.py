"""Online trajectory generation: jerk-limited motion to a goal that may change at any time."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import ArrayLike

from ikservo.errors import BadValueError, RefusedError
from ikservo.kinematics import finite_vector
from ikservo.kinematics.arrays import Vector
from ikservo.motion.point_to_point import JointMove, RuckigMotion, stop_trajectory
from ikservo.motion.trajectory import KinematicLimits, TrajectoryPoint

# Largest excess over a limit by rounding, rad or m; a tick is about 10⁻³ rad.
_ROUNDING = 1e-7

_Pieces = tuple[tuple[float, RuckigMotion], ...]


class OnlineTrajectory:
    """A trajectory of n joints whose goal can change while it runs, until it is stopped.

    All joints reach each goal at the same time, at rest, and as fast as the limits allow, without a
    stop before it or a jump in position, velocity or acceleration. Positions stay inside their
    bounds at every instant, also while braking for a new goal.

    Times are relative to the trajectory's start and never decrease; states before the last two
    goals are discarded. One thread may set goals while another reads states.

    Args:
        start: The start: joints at rest (n,), rad or m, or the state of a running motion, which
            then comes to rest.
        limits: The kinematic limits of each joint.
        lower: The lowest positions (n,); None means no bound. A start outside extends the bounds to
            the start, so that a joint slightly outside can move back.
        upper: The highest positions (n,); None means no bound.

    Attributes:
        duration_s: The time at which it is finally at rest; infinite until it is stopped.

    Raises:
        BadValueError: A shape is wrong, a number is not finite, or lower is above upper.
        RefusedError: The joints cannot come to rest inside their limits.
    """

    def __init__(
        self,
        start: ArrayLike | TrajectoryPoint,
        limits: Sequence[KinematicLimits],
        *,
        lower: ArrayLike | None = None,
        upper: ArrayLike | None = None,
    ) -> None:
        self._limits = tuple(limits)
        n = len(self._limits)
        if not isinstance(start, TrajectoryPoint):
            start = TrajectoryPoint.at_rest(finite_vector(start, n, "The start of the motion"))
        rest = stop_trajectory(start, self._limits)
        low, high = _check_bound(lower, n, -math.inf), _check_bound(upper, n, math.inf)
        if not (low <= high).all():
            raise BadValueError(
                "The vector of lower limits", low.tolist(), "numbers below the upper limits"
            )
        self._bounds = low, high
        self._lower = np.minimum(self._bounds[0], rest.start.position) - _ROUNDING
        self._upper = np.maximum(self._bounds[1], rest.start.position) + _ROUNDING
        if not self._ends_inside_limits(rest):
            hint = "Nothing was sent. Wait until the arm is at rest."
            raise RefusedError("The joints move too fast to stop inside their limits.", hint)
        self._pieces: _Pieces = ((0.0, rest),)
        self._aimed_s, self.duration_s = 0.0, math.inf

    @property
    def goal(self) -> Vector:
        """The final position (n,): the last goal, clipped to the bounds."""
        return self._pieces[-1][1].goal.copy()

    @property
    def settles_at_s(self) -> float:
        """The time at which the joints will be at rest at their goal, unless the goal changes."""
        since_s, move = self._pieces[-1]
        return since_s + move.duration_s

    def state(self, time_s: float) -> TrajectoryPoint:
        """Return position, velocity and acceleration (n,) at a time."""
        since_s, move = _piece_at(self._pieces, time_s)
        return move.state(time_s - since_s)

    def retarget(
        self, goal: ArrayLike, time_s: float, check: Callable[[RuckigMotion], None] | None = None
    ) -> Vector:
        """Set a new goal that applies from a given time on; return the final position (n,).

        A goal outside the bounds is clipped to the nearest position inside.

        Args:
            goal: The goal (n,), rad or m.
            time_s: Time of the change; not before the last change.
            check: Called with the motion before it is used; if it raises, nothing changes.

        Raises:
            BadValueError: The goal's shape is wrong, a number is not finite, or the time decreases.
            RefusedError: The trajectory was stopped, and stays unchanged.
        """
        clipped = np.clip(finite_vector(goal, len(self._limits), "The goal"), *self._bounds)
        self._check_time(time_s)
        if math.isfinite(self.duration_s):
            raise RefusedError("The motion has already ended.", "Start a new motion.")
        if not np.array_equal(clipped, self._pieces[-1][1].goal):
            pieces = self._first_inside(self._candidate_trajectories(clipped, time_s))
            if check:
                check(pieces[-1][1])
            self._pieces = pieces
        self._aimed_s = time_s
        return clipped

    def set_limits(self, limits: Sequence[KinematicLimits]) -> None:
        """Set the limits that apply from the next goal on; none may be lower than before."""
        self._limits = tuple(limits)

    def stop(self, time_s: float) -> None:
        """Come to rest as soon as the limits allow; ``duration_s`` is then finite.

        If braking at once would leave the bounds, the motion comes to rest at its goal. A second
        call changes nothing.

        Raises:
            BadValueError: The time decreases.
        """
        if math.isfinite(self.duration_s):
            return
        self._check_time(time_s)
        self._pieces = self._first_inside(self._candidate_stops(time_s))
        self._aimed_s, self.duration_s = time_s, max(self.settles_at_s, time_s)

    def _candidate_trajectories(self, goal: Vector, time_s: float) -> Iterator[_Pieces]:
        """Yield motions to a goal, the best first; the last one passes through the old goal."""
        before, current = _piece_at(self._pieces, time_s), self.state(time_s)
        for together in (True, False):
            try:
                yield before, (time_s, JointMove(current, goal, self._limits, together=together))
            except RefusedError:
                continue
        yield (
            *self._pieces,
            (max(self.settles_at_s, time_s), JointMove(self.goal, goal, self._limits)),
        )

    def _candidate_stops(self, time_s: float) -> Iterator[_Pieces]:
        """Yield motions to rest, the fastest first; the last one is the present motion."""
        try:
            stop = stop_trajectory(self.state(time_s), self._limits)
            yield _piece_at(self._pieces, time_s), (time_s, stop)
        except RefusedError:
            pass
        yield self._pieces

    def _first_inside(self, candidates: Iterator[_Pieces]) -> _Pieces:
        """Return the first candidate whose last piece is in bounds, else the last candidate."""
        pieces = self._pieces
        for pieces in candidates:
            if self._ends_inside_limits(pieces[-1][1]):
                break
        return pieces

    def _ends_inside_limits(self, move: RuckigMotion) -> bool:
        lowest, highest = move.extent
        return bool((lowest >= self._lower).all() and (highest <= self._upper).all())

    def _check_time(self, time_s: float) -> None:
        if not self._aimed_s <= time_s < math.inf:
            raise BadValueError(
                "The time of the goal", f"{time_s} s", f"a time of at least {self._aimed_s} s"
            )


def _piece_at(pieces: _Pieces, time_s: float) -> tuple[float, RuckigMotion]:
    """Return the piece of the trajectory at a time, and its start."""
    return next((piece for piece in reversed(pieces) if piece[0] <= time_s), pieces[0])


def _check_bound(values: ArrayLike | None, n: int, default: float) -> Vector:
    """Check one side of the bounds (n,); without values, every bound is ``default``."""
    given = np.full(n, default) if values is None else np.asarray(values, dtype=np.float64)
    if given.shape != (n,):
        raise BadValueError("A vector of limits", f"of shape {given.shape}", f"shape ({n},)")
    return given
