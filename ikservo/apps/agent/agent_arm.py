"""Operations that an agent may perform on an arm: read, plan, execute, stop; for any protocol."""

from __future__ import annotations

import contextlib
import threading
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from ikservo.app_discovery import find_part
from ikservo.apps.agent import tool_results as res
from ikservo.apps.agent.agent_journal import AgentJournal
from ikservo.apps.agent.allowance import Allowance, Budget, Consent
from ikservo.apps.agent.plan_picture import draw_plan, encode_png, shrink_step, shrunk
from ikservo.apps.agent.plan_store import Answer, OfferedPlan, PlanStore
from ikservo.arm import Arm
from ikservo.arm.result_json import encode_fields
from ikservo.arm.run_by_kind import end_of_motion
from ikservo.clock import RealClock
from ikservo.errors import (
    BadValueError,
    IkservoError,
    LatchedStopError,
    RefusedError,
    UnknownNameError,
    printable,
)
from ikservo.guard import StopKind, StopReason
from ikservo.ik import Target, solve
from ikservo.kinematics.arrays import Vector
from ikservo.model import arm_names, load_model
from ikservo.model.scene_file import describe_thing
from ikservo.planning.motion_plan import MotionPlan
from ikservo.planning.motions import MotionValue, MoveGripper, Wait
from ikservo.planning.preflight_planner import PlannedStart, PreflightPlanner

MAX_PROGRAM_STEPS = 200
"""Largest number of steps in a program, including repetitions."""

_MAX_THINGS = 50
_MAX_NAME, _MAX_WORDS = 80, 500  # characters
_MAX_SUNK_RAD = 0.1  # how far a limp arm may sink before its program begins
_KEPT_REFUSALS = 20
_BRAKE_TIMEOUT_S = 5.0  # braking takes 0.3 s; a busy machine is given more
_BY_BUDGET = "--allow slow"
_PERSON_ENDS_STOP = (
    "A person must end the stop on the server's page, or with: ikservo mcp --approve"
)


class AgentArm:
    """An arm that an agent may use within its owner's permissions; thread-safe.

    The methods raise an ``IkservoError`` if something cannot be read, planned or executed, if the
    owner or a person does not allow it, or if the journal cannot be written. The arm then holds.
    """

    def __init__(self, arm: Arm, allowance: Allowance, journal: AgentJournal) -> None:
        allowance.check(arm.zeros)
        self.arm, self.allowance, self.journal = arm, allowance, journal
        clock = RealClock()
        self.plans = PlanStore(clock)
        self._budget = Budget(allowance, clock)
        self._own_things: set[str] = set()
        self._stops, self._executing = arm.context.servos.stop_request, threading.Lock()
        self._refusals: deque[res.Refusal] = deque(maxlen=_KEPT_REFUSALS)
        self._last_picture: bytes | None = None

    def list_arms(self) -> list[res.ArmSummary]:
        """Return the connected arm first, then the arms that ikservo knows."""
        own = self.arm.model
        known = [load_model(name) for name in arm_names() if name != own.name]
        return [
            res.ArmSummary(name=each.name, title=quoted(each.title), is_connected=each is own)
            for each in (own, *known)
        ]

    def where(self) -> res.ArmStatus:
        """Return the measured state of the arm."""
        state = self.arm.where()
        return res.ArmStatus(
            tip_m=_point(state.tip_m),
            positions=state.positions,
            is_holding=bool(state.torque.all()),
            stopped_for=quoted(self.arm.stopped_for),
            held_things=tuple(map(quoted, self.arm.scene.held)),
            consent=self.allowance.consent.value,
            budget=self._budget.left(),
        )

    def reachable(self, position_m: Sequence[float]) -> res.Reach:
        """Check whether the tip can reach a point (3,) [m]; obstacles are ignored."""
        found = solve(self.arm.chain, Target(position_m))
        return res.Reach(
            is_reachable=found.reached,
            nearest_m=_point(found.nearest_m),
            error_m=found.position_error_m,
            at_limits=tuple(str(each) for each in found.binding),
        )

    def description(self) -> dict[str, Any]:
        """Return the joints of the arm with their limits in rad or m, and its poses."""
        arm = self.arm
        lower, upper = arm.limits()
        limits = zip(arm.joint_names, lower.tolist(), upper.tolist(), strict=True)
        return {
            "name": arm.model.name,
            "title": quoted(arm.model.title),
            "limits": {
                name: {"lower": low, "upper": high, "unit": arm.model.joint(name).joint_map.unit}
                for name, low, high in limits
            },
            "poses": [quoted(name) for name in arm.poses.all_poses()],
        }

    def explain(self) -> list[res.Refusal]:
        """Return the latest errors of the tools, the newest first."""
        return list(reversed(self._refusals))

    def note_error(self, tool: str, error: IkservoError) -> None:
        """Store an error for ``explain``, and write it to the journal."""
        names = ("target_m", "nearest_m", "instead_m", "binding", "along_m")
        details = {name: getattr(error, name) for name in names if getattr(error, name, None)}
        kind, words = type(error).__name__, quoted(error.message, _MAX_WORDS)
        hint = quoted(hint_for_agent(error), _MAX_WORDS)
        refusal = res.Refusal(tool=tool, kind=kind, message=words, hint=hint, details=details)
        self._refusals.append(refusal)
        with contextlib.suppress(IkservoError):  # a full disk must not hide the error itself
            self.journal.write("refused", tool=tool, kind=kind, message=words)

    def plan(self, motion: MotionValue[Any]) -> res.OfferedMotion:
        """Plan a motion within the owner's limits, and store the plan for ``execute``."""
        motion, stops = self.allowance.limited(motion), self._stops.count
        plan = None if isinstance(motion, MoveGripper | Wait) else self.arm.plan(motion)
        return self._offer(OfferedPlan([motion], plan, [_summary(motion, plan)], stops))

    def check_program(self, text: str) -> res.CheckedProgram:
        """Plan each step of a program; if all are possible, offer the program for execution."""
        program = find_part("program")(text)
        if not program.is_sequence:
            raise RefusedError(
                "The program is not a fixed list of motions.", "Write out each motion as a step."
            )
        count = len(program.steps) * program.repeat
        if count > MAX_PROGRAM_STEPS:
            expected = f"at most {MAX_PROGRAM_STEPS}"
            raise BadValueError("The number of steps with repetitions", count, expected)
        arm, name = self.arm, self.arm.model.name
        if program.arm != name:
            raise BadValueError("The program", f"for {program.arm}", f"a program for {name}")
        motions = [
            self.allowance.limited(step.to_motion(arm.model, program.speed_of(step)))
            for step in program.steps
        ]
        start, stops = arm.runner.start_position(), self._stops.count
        planned, steps = PlannedStart(start), list[res.StepReport]()
        # If the program repeats, its first step is also planned from the end of its last step.
        for index in (*range(len(motions)), *([0] if program.repeat > 1 else [])):
            error = self._plan_step(motions[index], planned)
            words = quoted(program.steps[index].description)
            steps.append(res.StepReport(number=index + 1, step=words, error=error))
        if any(each.error for each in steps):
            return res.CheckedProgram(steps=tuple(steps), plan=None)
        summary = [f"{number}: {_summary(each, None)}" for number, each in enumerate(motions, 1)]
        if program.repeat > 1:
            summary.append(f"all steps {program.repeat} times")
        offered = OfferedPlan(motions * program.repeat, None, summary, stops, start)
        return res.CheckedProgram(steps=tuple(steps), plan=self._offer(offered))

    def _plan_step(self, motion: MotionValue[Any], planned: PlannedStart) -> str:
        """Plan a step of a program; the next step starts where this step ends. Return any error."""
        preflight = PreflightPlanner(self.arm.context, planned, self.arm.poses)
        try:
            if isinstance(motion, MoveGripper | Wait):
                end, _ = end_of_motion(self.arm.context, preflight, motion, planned.joints)
            else:
                end = preflight.plan(motion).goal
        except IkservoError as error:
            return quoted(error.message, _MAX_WORDS)
        planned.joints = end
        return ""

    def _offer(self, offered: OfferedPlan) -> res.OfferedMotion:
        plan = self.plans.offer(offered).plan
        self.journal.write("planned", plan=offered.id, summary=offered.summary)
        return res.OfferedMotion(
            plan_id=offered.id,
            summary=tuple(offered.summary),
            duration_s=None if plan is None else round(plan.duration_s, 2),
            tip_at_end_m=None if plan is None else _point(plan.tip_m),
            needs_consent=self.allowance.consent in (Consent.NOTHING, Consent.ASK)
            or (self.allowance.consent is Consent.SLOW and not self._budget.covers(1)),
        )

    def picture_of(self, plan_id: str) -> bytes:
        """Return the picture of a plan as PNG."""
        plan = self.plans.find(plan_id).plan
        if plan is None:
            raise RefusedError("Only a plan with a single motion of the arm has a picture.")
        return encode_png(draw_plan(self.arm, plan))

    def ask(self, plan_id: str, client: str) -> OfferedPlan:
        """Request a person's consent to a plan unless the owner allows it; return the plan."""
        offered = self.plans.find(plan_id)
        self.journal.write("asked", plan=plan_id, client=quoted(client))
        if self.allowance.consent is Consent.NOTHING:
            hint = "The owner can restart the server with --allow ask."
            raise RefusedError("The owner of the arm does not allow any motion.", hint)
        if offered.answer is Answer.YES:
            return offered
        if self.allowance.consent is Consent.SIMULATOR:
            offered.answer, offered.answered_by = Answer.YES, "--allow simulator"
        elif self.allowance.consent is Consent.SLOW and self._budget.take(len(offered.motions)):
            offered.answer, offered.answered_by = Answer.YES, _BY_BUDGET
        else:
            offered.is_asked = True
        return offered

    def execute(self, plan_id: str) -> res.Execution:
        """Execute a plan that a person or the owner has allowed."""
        with self._executing:
            return self._execute(plan_id)

    def _execute(self, plan_id: str) -> res.Execution:
        offered = self.plans.find(plan_id)
        if offered.answer is not Answer.YES:
            raise RefusedError(f"Nobody has allowed plan {plan_id}.", "Call execute again.")
        if offered.answered_by == _BY_BUDGET and not self._budget.take(0):
            raise RefusedError(
                "The time during which motions need no approval has ended.", "Plan again."
            )
        self.plans.take(plan_id)
        self.journal.write("execute", plan=plan_id, allowed_by=offered.answered_by)
        try:
            with self._stops.requested(offered.stops):  # a stop after the offer cancels the plan
                self._stops.check_request()
                self._check_start(offered.start)
                results = tuple(self._run(each, offered.plan) for each in offered.motions)
        except BaseException as error:
            with contextlib.suppress(IkservoError):
                self.journal.write("failed", plan=plan_id, error=str(error))
            raise
        self.journal.write("done", plan=plan_id)
        return res.Execution(status="done", message="The motion has ended.", results=results)

    def _check_start(self, start: Vector | None) -> None:
        """Refuse a program if the arm is not at the joint positions (n,) of the program's start."""
        runner, units = self.arm.runner, self.arm.context.units_per_rad()
        if start is None or (abs(runner.start_position() - start) <= _MAX_SUNK_RAD * units).all():
            return
        raise RefusedError("The arm is not where the program begins.", "Check the program again.")

    def _run(self, motion: MotionValue[Any], plan: MotionPlan | None) -> Mapping[str, Any]:
        """Execute one motion; if it has a plan, execute exactly that plan."""
        arm = self.arm
        if isinstance(motion, MoveGripper | Wait):
            result = arm.execute(motion)
        else:
            # The plan must stay as the person has seen it: torque comes on first, so that a limp
            # arm is not replanned. A plan is refused if the arm has sunk too far from its start.
            arm.enable()
            result = arm.execute(replace(plan or arm.plan(motion), limp_arm=None))
        return {} if result is None else encode_fields(result)

    def stop(self, reason: str, by: str = "The agent") -> str:
        """Brake and hold; only a person can end the stop."""
        words = quoted(reason) or "no reason given"
        self.arm.request_stop(StopReason(StopKind.CLIENT, f"{by} stopped the arm: {words}"))
        with contextlib.suppress(IkservoError):
            self.journal.write("stop", by=by, reason=words)
        return f"Stopped. {_PERSON_ENDS_STOP}"

    def hold(self, reason: str) -> None:
        """Stop a motion, even one about to begin, because the agent can no longer supervise it."""
        self.arm.request_stop(StopReason(StopKind.CLIENT, reason))

    def end(self) -> None:
        """Stop a running motion, and wait until it has ended."""
        self.hold("The agent's server has ended.")
        if self._executing.acquire(timeout=_BRAKE_TIMEOUT_S):
            self._executing.release()

    def acknowledge(self, who: str) -> None:
        """End a stop on behalf of a person, even if the journal is full."""
        with contextlib.suppress(IkservoError):
            self.journal.write("acknowledge", by=who)
        self.plans.withdraw_questions()
        self.arm.acknowledge()

    def things(self) -> list[res.SceneThing]:
        """Return the things around the arm."""
        own, described = self._own_things, map(describe_thing, self.arm.scene.things)
        return [
            res.SceneThing(
                name=quoted(thing.name), kind=kind, sizes=sizes, is_own=thing.name in own
            )
            for thing, (kind, sizes) in zip(self.arm.scene.things, described, strict=True)
        ]

    def add_thing(self, kind: str, name: str, sizes: Mapping[str, Any]) -> list[res.SceneThing]:
        """Add a thing that the arm must not touch."""
        if len(self._own_things) >= _MAX_THINGS:
            raise RefusedError(f"The agent has added {_MAX_THINGS} things.", "Remove one first.")
        self.journal.write("scene add", kind=kind, name=name, sizes=sizes)
        self.arm.scene.add(kind, name, **sizes)
        self._own_things.add(name)
        return self.things()

    def remove_thing(self, name: str) -> list[res.SceneThing]:
        """Remove a thing that the agent has added; the owner's things stay."""
        if name not in self._own_things:
            raise UnknownNameError("thing of the agent", name, self._own_things)
        self.journal.write("scene remove", name=name)
        self.arm.scene.remove(name)
        self._own_things.discard(name)
        return self.things()

    def look(self) -> bytes:
        """Take a picture with the calibrated camera; return it as a small PNG."""
        picture = cast("NDArray[np.uint8]", self.arm.camera.picture())
        self._last_picture = encode_png(shrunk(picture))
        return self._last_picture

    def last_picture(self) -> bytes:
        """Return the last picture as PNG; take one if there is none."""
        return self._last_picture or self.look()

    def point_of_pixel(self, u: float, v: float, height_m: float | None = None) -> res.SeenThing:
        """Return the first point that a pixel (right, down) sees, or the point at ``height_m``."""
        step = shrink_step(self.arm.camera.model().lens.size)
        u, v = step * u, step * v
        if height_m is not None:
            point_m = self.arm.camera.point_on_table(u, v, height_m)
            return res.SeenThing(point_m=_point(point_m), thing=None)
        seen = self.arm.camera.point_seen(u, v)
        return res.SeenThing(point_m=_point(seen.point_m), thing=seen.thing and quoted(seen.thing))


def hint_for_agent(error: IkservoError) -> str:
    """Return the hint of an error, unless it names Python methods, which an agent cannot call."""
    if isinstance(error, LatchedStopError):
        return _PERSON_ENDS_STOP
    return "" if "arm." in error.hint else error.hint


def quoted(text: str, most: int = _MAX_NAME) -> str:
    """Return an untrusted text as one printable line of limited length."""
    line = " ".join(printable(text).split())
    return line if len(line) <= most else f"{line[:most]}…"


def _summary(motion: MotionValue[Any], plan: MotionPlan | None) -> str:
    words = quoted(str(motion), _MAX_WORDS)
    if plan is None:
        return ", ".join(filter(None, (words, getattr(motion, "speed", ""))))
    x, y, z = (1000.0 * plan.tip_m).tolist()
    around = f", by a detour, because {quoted(plan.around)}" if plan.around else ""
    return (
        f"{words}: {plan.duration_s:.1f} s, {plan.speed}, the tip ends at "
        f"x {x:.0f} mm, y {y:.0f} mm, z {z:.0f} mm{around}"
    )


def _point(position_m: Any) -> res.Point:  # noqa: ANN401  # an array (3,)
    x, y, z = np.round(np.asarray(position_m, dtype=float), 5).tolist()
    return x, y, z
