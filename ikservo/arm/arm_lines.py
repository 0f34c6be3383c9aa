"""Straight-line motions of the tool, and motions through several points."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from typing import Literal, Unpack, overload

from numpy.typing import ArrayLike

from ikservo.arm.arguments import check_callable, parse_number, parse_points
from ikservo.arm.arm_skills import Skills
from ikservo.arm.background_motion import Motion
from ikservo.arm.motion_options import OnProgress, PointOptions, ThroughOptions
from ikservo.arm.plan import MotionPlan
from ikservo.arm.reports import MoveResult
from ikservo.arm.tool_orientation import KEEP_BEST_EFFORT, ToolOrientation, check_orientation
from ikservo.kinematics.arrays import Vector

__all__ = ["BLEND_M", "Lines"]

BLEND_M = 0.02
"""How far from a way-point the arm leaves its way to go on to the next."""

_Planning = Callable[[Vector, str], MotionPlan]
"""Makes a plan from where the joints are (n,), for a speed."""


class Lines(Skills):
    """What ``Arm`` does besides going to one point; each plans first and moves then."""

    @abstractmethod
    def plan_cartesian(self, planning: _Planning, speed: str) -> MotionPlan:
        """Make a plan from where the arm is, at the speed it may go, and look at its way."""

    @abstractmethod
    def _execute_move(self, plan: MotionPlan, on_progress: OnProgress | None) -> MoveResult:
        """Execute a plan of the tip; see ``Arm``."""

    @abstractmethod
    def _plan_from_held(self, planning: Callable[[], MotionPlan]) -> MotionPlan:
        """Return a plan from where the arm holds; see ``Arm``."""

    def plan_line(
        self,
        position_m: ArrayLike,
        *,
        speed: str = "normal",
        stance: ToolOrientation = KEEP_BEST_EFFORT,
        orientation: ArrayLike | None = None,
    ) -> MotionPlan:
        """Plan a straight line of the tip to a point; see ``move_line``."""
        stance = check_orientation(stance, orientation)
        return self.plan_through([position_m], line=True, speed=speed, stance=stance)

    @overload
    def move_line(
        self,
        position_m: ArrayLike,
        *,
        wait: Literal[True] = True,
        **options: Unpack[PointOptions],
    ) -> MoveResult: ...
    @overload
    def move_line(
        self, position_m: ArrayLike, *, wait: Literal[False], **options: Unpack[PointOptions]
    ) -> Motion[MoveResult]: ...
    def move_line(
        self,
        position_m: ArrayLike,
        *,
        speed: str = "normal",
        stance: ToolOrientation = KEEP_BEST_EFFORT,
        orientation: ArrayLike | None = None,
        on_progress: OnProgress | None = None,
        wait: bool = True,
    ) -> MoveResult | Motion[MoveResult]:
        """Move the tip to a point on a straight line, and block until the arm is at rest.

        Args:
            position_m: The point (3,), metres, in the arm's base frame.
            speed: slow, normal or fast.
            stance: How the tool shall stand at the end, turned evenly on the way; if nothing is
                asked it is kept, as well as the arm can.
            orientation: The orientation R_base_tip (3, 3) at the end, instead of a stance.
            on_progress: Called in every control cycle.
            wait: Whether to block; else the motion runs in the background, see ``move_to``.

        Raises:
            UnreachableError: Something on the line cannot be reached; nothing has moved.
            OrientationError: The tool cannot stand as asked; nothing has moved.
            RefusedError: The guard will not pass it.
            StoppedError: It was stopped by ``stop`` or from another terminal; the arm holds.
            KeyboardInterrupt: Ctrl-C; the arm was braked and holds.
        """
        check_callable("on_progress", on_progress)
        asked = check_orientation(stance, orientation)

        def move() -> MoveResult:
            plan = self._plan_from_held(
                lambda: self.plan_line(position_m, speed=speed, stance=asked)
            )
            return self._execute_move(plan, on_progress)

        return self._background.run_blocking(move) if wait else self._background.start(move)

    def plan_through(
        self,
        points_m: Sequence[ArrayLike],
        *,
        blend_m: float = BLEND_M,
        line: bool = False,
        speed: str = "normal",
        stance: ToolOrientation = KEEP_BEST_EFFORT,
        orientation: ArrayLike | None = None,
    ) -> MotionPlan:
        """Plan a motion through points without a stop; see ``move_through``."""
        planner, blend_m = self.workings.planner, parse_number("The blend", blend_m)
        points_m = parse_points(points_m)
        make = planner.plan_linear if line else planner.plan_waypoints
        asked = check_orientation(stance, orientation)
        return self.plan_cartesian(
            lambda here, pace: make(here, points_m, pace, blend_m, asked), speed
        )

    @overload
    def move_through(
        self,
        points_m: Sequence[ArrayLike],
        *,
        wait: Literal[True] = True,
        **options: Unpack[ThroughOptions],
    ) -> MoveResult: ...
    @overload
    def move_through(
        self,
        points_m: Sequence[ArrayLike],
        *,
        wait: Literal[False],
        **options: Unpack[ThroughOptions],
    ) -> Motion[MoveResult]: ...
    def move_through(
        self,
        points_m: Sequence[ArrayLike],
        *,
        blend_m: float = BLEND_M,
        line: bool = False,
        speed: str = "normal",
        stance: ToolOrientation = KEEP_BEST_EFFORT,
        orientation: ArrayLike | None = None,
        on_progress: OnProgress | None = None,
        wait: bool = True,
    ) -> MoveResult | Motion[MoveResult]:
        """Move the tip through points, rest at the last, and block until then.

        Args:
            points_m: The points (k, 3), metres, in the arm's base frame.
            blend_m: Within which distance the tip passes each point but the last.
            line: Whether it goes straight from point to point; else the joints do.
            speed: slow, normal or fast.
            stance: How the tool shall stand at the last point.
            orientation: The orientation R_base_tip (3, 3) there, instead of a stance.
            on_progress: Called in every control cycle.
            wait: Whether to block; else the motion runs in the background, see ``move_to``.

        Raises:
            UnreachableError: A point, or a line to it, cannot be reached; nothing has moved.
            OrientationError: The tool cannot stand as asked; nothing has moved.
            RefusedError: The guard will not pass it.
            StoppedError: It was stopped by ``stop`` or from another terminal; the arm holds.
            KeyboardInterrupt: Ctrl-C; the arm was braked and holds.
        """
        check_callable("on_progress", on_progress)
        asked, points_m = check_orientation(stance, orientation), parse_points(points_m)

        def planned() -> MotionPlan:
            return self.plan_through(
                points_m, blend_m=blend_m, line=line, speed=speed, stance=asked
            )

        def move() -> MoveResult:
            return self._execute_move(self._plan_from_held(planned), on_progress)

        return self._background.run_blocking(move) if wait else self._background.start(move)
