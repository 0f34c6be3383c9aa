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

__all__ = ["OnlineTrajectory"]

# By how much rounding may put a position outside its limits, rad or m; a tick is 10⁻³.
_ROUNDING = 1e-7

_Pieces = tuple[tuple[float, RuckigMotion], ...]


class OnlineTrajectory:
    """A course of n joints that is aimed at new goals while it runs, and goes on until it is ended.

    Each goal is reached as fast as the paces allow, at rest and all joints together, without a
    stop or a jump in position, velocity or acceleration on the way from the last one. Positions
    stay inside the limits at every instant, also where braking for a new goal goes past it.

    Times are the course's own and never go back; what was before the last aim but one is
    forgotten. One thread may aim while another asks for states.

    Args:
        start: Where it begins: joints at rest (n,), rad or m, or the state of a running motion,
            which then comes to rest.
        paces: The pace of each joint.
        lower: The lowest positions (n,); none if None. A start outside widens the limits to it,
            so that a joint that is a little outside can be led back.
        upper: The highest positions (n,); none if None.

    Raises:
        BadValueError: A shape is wrong, a number is no number, or lower is above upper.
        RefusedError: The joints cannot come to rest inside their limits.
    """

    def __init__(
        self,
        start: ArrayLike | TrajectoryPoint,
        paces: Sequence[KinematicLimits],
        *,
        lower: ArrayLike | None = None,
        upper: ArrayLike | None = None,
    ) -> None:
        self._paces = tuple(paces)
        n = len(self._paces)
        rest = stop_trajectory(
            start if isinstance(start, TrajectoryPoint) else _rest_state(start, n), self._paces
        )
        self._limits = _check_limits(lower, upper, n)
        self._lower = np.minimum(self._limits[0], rest.start.position) - _ROUNDING
        self._upper = np.maximum(self._limits[1], rest.start.position) + _ROUNDING
        if not self._ends_inside_limits(rest):
            raise RefusedError(
                "The joints are too fast to stop inside their limits.",
                "Nothing was sent. Wait until the arm is at rest.",
            )
        self._pieces: _Pieces = ((0.0, rest),)
        self._aimed_s, self._end_s = 0.0, math.inf

    @property
    def duration_s(self) -> float:
        """Return when it is at rest for good; infinite until it is ended."""
        return self._end_s

    @property
    def goal(self) -> Vector:
        """Return where it comes to rest (n,): what it was last aimed at, inside the limits."""
        return self._pieces[-1][1].goal.copy()

    @property
    def settles_at_s(self) -> float:
        """Return when it is at rest there, if nobody aims it elsewhere."""
        since_s, move = self._pieces[-1]
        return since_s + move.duration_s

    def state(self, time_s: float) -> TrajectoryPoint:
        """Return position, velocity and acceleration (n,) at a time."""
        since_s, move = _piece_at(self._pieces, time_s)
        return move.state(time_s - since_s)

    def retarget(
        self, goal: ArrayLike, time_s: float, look: Callable[[RuckigMotion], None] | None = None
    ) -> Vector:
        """Go to another goal from a time on; return where it will come to rest (n,).

        A goal outside the limits is moved to the nearest position inside: whoever pulls an arm
        past a limit finds it waiting there.

        Args:
            goal: Where to come to rest (n,), rad or m.
            time_s: From when on; not before the last aim.
            look: Looks at the way there before it is taken; what it raises leaves all as it was.

        Raises:
            BadValueError: The goal's shape is wrong, a number is not finite, or the time goes back.
            RefusedError: The course was ended. It goes on as it was.
        """
        wanted = np.clip(finite_vector(goal, len(self._paces), "The goal"), *self._limits)
        self._check_time(time_s)
        if math.isfinite(self._end_s):
            raise RefusedError("The motion has been ended.", "Begin another one.")
        if not np.array_equal(wanted, self._pieces[-1][1].goal):
            pieces = self._first_inside(self._candidate_trajectories(wanted, time_s))
            if look:
                look(pieces[-1][1])
            self._pieces = pieces
        self._aimed_s = time_s
        return wanted

    def set_limits(self, paces: Sequence[KinematicLimits]) -> None:
        """Take other paces for the ways from the next aim on, none slower than those before."""
        self._paces = tuple(paces)

    def stop(self, time_s: float) -> None:
        """Come to rest as soon as the paces allow, from a time on; ``duration_s`` is then finite.

        Where braking at once would pass a limit, it comes to rest where it was going. To end it
        again changes nothing.

        Raises:
            BadValueError: The time goes back.
        """
        if math.isfinite(self._end_s):
            return
        self._check_time(time_s)
        self._pieces = self._first_inside(self._candidate_stops(time_s))
        self._aimed_s, self._end_s = time_s, max(self.settles_at_s, time_s)

    def _candidate_trajectories(self, goal: Vector, time_s: float) -> Iterator[_Pieces]:
        """Yield ways to a goal, the best first; the last goes by where the joints were going."""
        before, here = _piece_at(self._pieces, time_s), self.state(time_s)
        for together in (True, False):
            try:
                yield before, (time_s, JointMove(here, goal, self._paces, together=together))
            except RefusedError:
                continue
        yield (
            *self._pieces,
            (max(self.settles_at_s, time_s), JointMove(self.goal, goal, self._paces)),
        )

    def _candidate_stops(self, time_s: float) -> Iterator[_Pieces]:
        """Yield ways to come to rest, the fastest first; the last is the one it is on."""
        try:
            stop = stop_trajectory(self.state(time_s), self._paces)
            yield _piece_at(self._pieces, time_s), (time_s, stop)
        except RefusedError:
            pass
        yield self._pieces

    def _first_inside(self, ways: Iterator[_Pieces]) -> _Pieces:
        """Return the first way whose last piece is inside the limits, else the last way."""
        way = self._pieces
        for way in ways:
            if self._ends_inside_limits(way[-1][1]):
                break
        return way

    def _ends_inside_limits(self, move: RuckigMotion) -> bool:
        lowest, highest = move.extent
        return bool((lowest >= self._lower).all() and (highest <= self._upper).all())

    def _check_time(self, time_s: float) -> None:
        if not self._aimed_s <= time_s < math.inf:
            raise BadValueError(
                "The time of the aim", f"{time_s} s", f"a time from {self._aimed_s} s on"
            )


def _piece_at(pieces: _Pieces, time_s: float) -> tuple[float, RuckigMotion]:
    """Return the piece that a time lies in, and when it began."""
    return next((piece for piece in reversed(pieces) if piece[0] <= time_s), pieces[0])


def _rest_state(joints: ArrayLike, n: int) -> TrajectoryPoint:
    return TrajectoryPoint.at_rest(finite_vector(joints, n, "The start of the motion"))


def _check_limits(
    lower: ArrayLike | None, upper: ArrayLike | None, n: int
) -> tuple[Vector, Vector]:
    low = _check_bound(lower, n, -math.inf)
    high = _check_bound(upper, n, math.inf)
    if not (low <= high).all():
        raise BadValueError("The lower limits", low.tolist(), "numbers below the upper limits")
    return low, high


def _check_bound(values: ArrayLike | None, n: int, default: float) -> Vector:
    """Return one end of the limits; endless joints have an infinite one."""
    given = np.full(n, default) if values is None else np.asarray(values, dtype=np.float64)
    if given.shape != (n,):
        raise BadValueError("The limits", f"of shape {given.shape}", f"shape ({n},)")
    return given
