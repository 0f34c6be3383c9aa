"""Background planning of the path to the goal of the preview, before the path is shown."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from copy import copy
from dataclasses import dataclass, field
from threading import Event

import numpy as np

from ikservo.apps.page.dragging.snapshot import GoalRefusal
from ikservo.apps.page.dragging.target_marker import TargetMarker
from ikservo.arm import Arm, MotionPlan
from ikservo.errors import (
    BlockedError,
    CollisionError,
    IkservoError,
    RefusedError,
    StoppedError,
    UnreachableError,
)
from ikservo.kinematics.arrays import Vector
from ikservo.planning.motion_plan import sample_states
from ikservo.planning.motions import MoveJoints, MoveTo
from ikservo.planning.preflight_planner import PlannedStart, PreflightPlanner
from ikservo.planning.reports import OnProgress

_PERIOD_S = 0.04  # between plans during a drag, so that its picture can be drawn
_POSTURES = 25  # number of postures along a path for drawing
_NEAR_TICKS = 3.0
_SAG_TICKS = 100.0  # largest sag of a limp arm's joint until torque is on
_STRAIGHT = 1.001  # a path is straight if it is at most this factor longer than a line
_numbers = itertools.count(1)

SeveralMotions = tuple[MotionPlan, Callable[[Arm, OnProgress], object]]
"""One plan of several motions, to be shown, and the function that executes them."""


def refusal_of(goal: Vector, error: IkservoError) -> GoalRefusal:
    """Describe for the page why a goal (n,) was refused."""
    if not isinstance(error, BlockedError):
        return GoalRefusal(goal, error.message)
    pair = error.pair if isinstance(error, CollisionError) else ()
    return GoalRefusal(goal, f"Refused: {error.cause}.", pair)


class PlanRequest:
    """A requested plan, and the present state on which it depends; reads no servo.

    Args:
        arm: The arm.
        goal: All joints (n,); the same array as in the preview.
        start: The start of the motion (n,).
        speed: The speed class.
        is_chosen: Whether the goal is final; during a drag only its straight path is checked.
        marker: The target of the tip for which the goal was found, if there is one.
        plan: Plans several motions instead, in the planner's thread; then the goal is not used.
    """

    def __init__(
        self,
        arm: Arm,
        goal: Vector,
        start: Vector,
        speed: str,
        *,
        is_chosen: bool = True,
        marker: TargetMarker | None = None,
        plan: Callable[[PlanRequest], SeveralMotions | None] | None = None,
    ) -> None:
        servos = arm.context.servos
        self.goal, self.start, self.speed, self.plan = goal, start, speed, plan
        self.is_chosen, self.marker = is_chosen, marker
        self.is_limp = not servos.torque.is_on
        is_first = servos.torque.first_motion_due or self.is_limp
        self.allowed_speed = "slow" if is_first else speed
        ticks = [driven.joint_map.unit_per_tick for driven in servos.driven_joints]
        self.near = _NEAR_TICKS * np.array(ticks)  # tolerance of the start of a plan
        self.sag = _SAG_TICKS * np.array(ticks)
        lower, upper = arm.limits()
        self._is_outside = (start < lower) | (start > upper)
        scene, here = arm.scene, arm.context.surroundings
        moving = [each.turn.is_of_other(here) for each in scene.arms]
        self._around = (scene.things, scene.held, scene.arms, moving)
        self.stops = servos.stop_request.count

    @property
    def is_reached(self) -> bool:
        """Whether the arm is at the goal."""
        return bool((np.abs(self.goal - self.start) <= self.near).all())

    def has_sagged_since(self, before: PlanRequest) -> bool:
        """Return whether the only change is that a limp arm sank a little.

        For a joint outside its limits, even a few ticks count, because the guard may not let it
        move back to the start of the plan. Plans of several motions also allow this for an arm
        that is not limp, because a resting arm may move within its backlash.
        """
        there = copy(self)
        there.start = before.start
        sunk = np.abs(self.start - before.start)
        return (
            (before.is_limp or before.plan is not None)
            and bool((sunk <= self.sag).all())
            and bool(((sunk > self.near) | (before._is_outside & (sunk > 0.0))).any())
            and not there.change_since(before)
        )

    def goal_from(self, start: Vector) -> Vector:
        """Return the goal (n,) for another start; a joint kept outside its limits stays there."""
        is_kept = self._is_outside & (np.abs(self.goal - self.start) <= self.near)
        return np.where(is_kept, start, self.goal)

    def change_since(self, before: PlanRequest) -> str:
        """Describe the change since another request; empty if its plan may be carried out."""
        if self.goal is not before.goal:
            return "Another target was chosen"
        if (np.abs(self.start - before.start) > self.near).any():
            return "The arm has moved since"
        if self._around != before._around:
            return "The things around the arm have changed"
        is_too_fast = self.allowed_speed == "slow" != before.allowed_speed
        if self.speed != before.speed or is_too_fast:
            return "The speed has changed"
        return "" if self.stops == before.stops else "The arm was stopped"


@dataclass(frozen=True, slots=True, eq=False)
class PlannedPath:
    """The result of a request: a plan, or a refusal; neither while it is being planned.

    Attributes:
        request: The request; its goal differs if the target is reached in another posture.
        plan: The plan.
        postures: The chain's joints (dof,), and all joints by name, at equal time steps.
        is_straight: Whether the joints go straight to the goal.
        refusal: The reason why the goal is refused.
        number: A unique number.
        run: Executes the plan if it has several motions; None for a single motion.
    """

    request: PlanRequest
    plan: MotionPlan | None = None
    postures: Sequence[tuple[Vector, Mapping[str, float]]] = ()
    is_straight: bool = True
    refusal: GoalRefusal | None = None
    number: int = field(default_factory=lambda: next(_numbers))
    run: Callable[[Arm, OnProgress], object] | None = None

    def plan_for(self, now: PlanRequest) -> MotionPlan:
        """Return the plan if nothing on which it depends has changed, except a limp arm's sag.

        Raises:
            RefusedError: Something has changed, or there is no plan.
        """
        change = now.change_since(self.request)
        if change and not now.has_sagged_since(self.request):
            raise RefusedError(
                f"{change}; planning again.", "Press Go there again when the path is shown."
            )
        if self.refusal is not None:
            raise RefusedError(self.refusal.reason, "Nothing moved. Choose another target.")
        if self.plan is None:
            raise RefusedError(
                "The path to the target is not planned yet.", "Wait until it is shown."
            )
        return self.plan

    def is_of(self, request: PlanRequest) -> bool:
        """Check whether this result, a path or a refusal, belongs to an equal request."""
        is_same = not request.change_since(self.request)
        return is_same and (self.plan is not None or self.request.is_chosen >= request.is_chosen)


def plan_path(arm: Arm, request: PlanRequest, withdrawn: Event | None = None) -> PlannedPath:
    """Plan the path to a requested goal; the result contains the refusal if there is no path.

    Nothing moves, and no servo is read. The search ends once ``withdrawn`` is set.
    """
    index = arm.joint_index
    start = PlannedStart(request.start, request.allowed_speed)
    planner = PreflightPlanner(arm.context, start, arm.poses)
    stop_request = arm.context.servos.stop_request
    try:
        with stop_request.requested(request.stops, withdrawn=withdrawn):
            if request.plan is None:
                plan, run = _plan_to_goal(planner, arm, request), None
            elif (several := request.plan(request)) is not None:
                plan, run = several
            else:
                return PlannedPath(request)
    except StoppedError:
        return PlannedPath(request)
    except IkservoError as error:
        return PlannedPath(request, refusal=refusal_of(request.goal, error))
    joints = sample_states(plan.trajectory)[0]
    shown = joints[np.linspace(0, len(joints) - 1, _POSTURES).astype(int)]
    postures = [(index.chain_joints(each), index.by_name(each)) for each in shown]
    if run is None and not np.allclose(plan.goal, request.goal):
        request = copy(request)
        request.goal = plan.goal
    length = float(np.linalg.norm(np.diff(joints, axis=0), axis=1).sum())
    is_straight = length < _STRAIGHT * float(np.linalg.norm(plan.goal - plan.start))
    return PlannedPath(request, plan, postures, is_straight, run=run)


def _plan_to_goal(planner: PreflightPlanner, arm: Arm, request: PlanRequest) -> MotionPlan:
    """Plan to the goal; if it is refused, to other joints with the tip at the target."""
    index, marker, speed = arm.joint_index, request.marker, request.speed
    goals = index.by_name(request.goal)
    try:
        return planner.plan(MoveJoints(goals, speed=speed, straight=not request.is_chosen))
    except BlockedError:
        moves = np.abs(request.goal - request.start) > request.near
        has_more = request.is_chosen and not (moves & index.outside_chain()).any()
        if has_more and marker is not None and marker.reached and marker.stance is not None:
            with suppress(RefusedError, UnreachableError):
                return planner.plan(MoveTo(marker.target_m, speed=speed, stance=marker.stance))
        raise


class GoalPlanner:
    """Planner of one path at a time, in a thread; a new request replaces the running one.

    Attributes:
        path: The path to the goal; None if there is none.
    """

    def __init__(self, arm: Arm) -> None:
        self._arm = arm
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="ikservo plan")
        self._busy: tuple[PlanRequest, Event, Future[PlannedPath]] | None = None
        self._asked_s = -1e9
        self.path: PlannedPath | None = None

    def update(self, request: PlanRequest | None, now_s: float) -> None:
        """Plan the present request unless it was already planned, and drop an obsolete request.

        During a drag the path to the previous goal is kept until the next path is planned.
        """
        if self._collect_result(request):
            return
        if request is None:
            self.path = None
            return
        if self.path is None or not self.path.is_of(request):
            self.path = PlannedPath(request) if request.is_chosen else self.path
        elif self.path.plan is not None or self.path.refusal is not None:
            return
        if self._busy is None and now_s - self._asked_s >= _PERIOD_S:
            self._asked_s, withdrawn = now_s, Event()
            future = self._worker.submit(plan_path, self._arm, request, withdrawn)
            self._busy = request, withdrawn, future

    def close(self) -> None:
        """Cancel the running search."""
        if self._busy is not None:
            self._busy[1].set()
        self._worker.shutdown(wait=False, cancel_futures=True)

    def _collect_result(self, wanted: PlanRequest | None) -> bool:
        """Take a finished plan; return whether it is still wanted. End an obsolete search."""
        if self._busy is None:
            return False
        request, withdrawn, future = self._busy
        is_wanted = wanted is not None and not wanted.change_since(request)
        if request.is_chosen and not is_wanted:
            withdrawn.set()
        if future.done():
            self._busy = None
            if is_wanted or not request.is_chosen:
                error = future.exception()
                if error is None:
                    self.path = future.result()
                else:  # a bug in the planner; the page goes on
                    refusal = GoalRefusal(request.goal, f"The planner failed: {error!r}.")
                    self.path = PlannedPath(request, refusal=refusal)
        return self._busy is None and is_wanted
