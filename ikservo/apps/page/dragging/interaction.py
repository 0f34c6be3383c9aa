"""Conversion of user input to goals: pointer gestures, held controls, typed values, poses."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Sequence

import numpy as np

from ikservo.apps.page.dragging.drag import Drag, MovedThing
from ikservo.apps.page.dragging.drag_commands import DragCommand, DragTarget, JointTarget
from ikservo.apps.page.dragging.drag_solver import AUTO, DragSolver, PosturePreference
from ikservo.apps.page.dragging.goal_history import GoalHistory, PastGoal
from ikservo.apps.page.dragging.goal_planning import PlannedPath
from ikservo.apps.page.dragging.hand_control import HandControl
from ikservo.apps.page.dragging.held_controls import GamepadControl, gripper_control
from ikservo.apps.page.dragging.labels import describe_target
from ikservo.apps.page.dragging.snapshot import ArmSnapshot, GoalRefusal, LogEntry
from ikservo.apps.page.dragging.solver_demo import ITERATIVE, SOLVERS, SolverTrace, trace_method
from ikservo.apps.page.dragging.target_marker import TargetMarker
from ikservo.apps.page.dragging.tool_handles import ToolDrag
from ikservo.apps.page.dragging.typed_targets import JointRanges, ToolTargets
from ikservo.apps.page.messages import page_messages as msg
from ikservo.apps.page.messages.page_messages import Message
from ikservo.apps.page.picking.lens_camera import PictureSurface
from ikservo.apps.page.picking.picking import PickCandidate, Picker, PointerContext
from ikservo.apps.page.picking.projection import Camera, Viewport
from ikservo.apps.page.picking.raycast import link_shapes, thing_shapes
from ikservo.apps.page.picking.viewpoints import (
    Viewpoint,
    arm_extent,
    available_views,
    make_camera,
)
from ikservo.arm import Arm
from ikservo.clock import Clock
from ikservo.errors import UnknownNameError
from ikservo.ik import Target
from ikservo.kinematics.arrays import Vector
from ikservo.model.arm_model import Obstacle
from ikservo.model.collision_capsules import capsules_of

_STEPS_HZ = 30.0
_MAX_WARNINGS = 6


class Interaction:
    """Converter from input messages to the goal of all joints; without a goal, the arm holds.

    Attributes:
        goal: Goal of all joints (n,), rad or m; None to hold position.
        marker: The target of the goal, if there is one.
        path: The path to the goal in the preview; None if there is none.
        refusal: The reason why the guard refuses the goal; None if the goal is allowed.
        hover: The link that a press would grab.
        under: Everything under the pointer; None is the plane in which a click moves the tip.
        chosen: Index of the thing under the pointer that a press selects.
        solve_s: Duration of the last solve.
        solver_text: Progress of a chosen solver method in the current drag.
        preference: The preferred posture.
        solver_trace: Iterations of a chosen method on the last click, to be drawn one by one.
        history: Earlier goals.
        hand: The hand that moves the goal.
        messages: Messages about targets, the oldest first.
        revision: Changes whenever the scene has to be drawn again.
        resets: The number of times that the goal was dropped.
    """

    def __init__(self, arm: Arm, clock: Clock) -> None:
        chain = arm.chain
        self._arm, self._chain, self._clock = arm, chain, clock
        self._index = arm.joint_index
        picker = Picker(link_shapes(capsules_of(arm.model)))
        self._drag = Drag(chain, picker, Picker(thing_shapes(arm.scene.things)))
        self._tool_drag = ToolDrag(chain)
        self._solver, self._gamepad = DragSolver(chain), GamepadControl()
        self._gripper, self.hand = gripper_control(arm), HandControl(arm)
        self._ranges, self._tool_targets = JointRanges(arm), ToolTargets(arm)
        self._command: DragCommand | None = None
        self.solver_trace: SolverTrace | None = None
        self._trace_start_s = 0.0
        self.goal: Vector | None = None
        self.marker: TargetMarker | None = None
        self.path: PlannedPath | None = None
        self.refusal: GoalRefusal | None = None
        self.hover: str | None = None
        self.under: tuple[PickCandidate | None, ...] = ()
        self.chosen = 0
        self._pointer: tuple[float, float] | None = None
        self.solve_s: float | None = None
        self.solver_text = ""
        self.preference = PosturePreference()
        self.history = GoalHistory()
        self.messages: deque[LogEntry] = deque(maxlen=_MAX_WARNINGS)
        self.revision = self.resets = 0
        self._logged: GoalRefusal | None = None
        self._drag_recorded = False  # whether the goal before this drag is in the history
        self._warm_up()

    @property
    def camera(self) -> Camera | None:
        """The camera to keep during a drag."""
        return self._drag.camera

    @property
    def grabbed_link(self) -> str | None:
        """The link that is being dragged."""
        return self._drag.grabbed_link

    @property
    def _is_dragging(self) -> bool:
        return self._drag.is_busy or self._tool_drag.is_busy

    @property
    def is_choosing(self) -> bool:
        """Whether the goal is still being chosen: dragged, or solved for."""
        return self._is_dragging or self._command is not None or self.hand.is_held

    @property
    def picked_object(self) -> str | None:
        """The object of the scene that a press would pick."""
        found = self.under[self.chosen] if self.under else None
        return found.hit.link if found is not None and found.kind == "object" else None

    @property
    def drawn_goal(self) -> Vector | None:
        """All joints (n,) to draw as the goal: at the target, or after several motions."""
        path = self.path if self.goal is None else None
        return self.goal if path is None or path.run is None or not path.plan else path.plan.goal

    @property
    def solver(self) -> str:
        """The name of the solver in use: ``auto`` or one of ``SOLVERS``."""
        return self._solver.method

    @property
    def solvers(self) -> list[str]:
        """The names of the available solvers."""
        return [AUTO, *SOLVERS]

    def reset(self) -> None:
        """Cancel the drag and drop the goal: the arm holds."""
        self.finish_target()
        self.goal = self.marker = self.path = self.solver_trace = None
        self.revision += 1
        self.resets += 1

    def show_path(self, path: PlannedPath | None, refusal: GoalRefusal | None) -> None:
        """Show the path to the goal, or its refusal; log it once the goal is final."""
        if path is not self.path or refusal is not self.refusal:
            self.path, self.refusal = path, refusal
            self.revision += 1
            if path is not None and path.plan is not None and path.plan.around:
                self.log(f"On the straight path, {path.plan.around}; the arm goes around.")
        if refusal is not None and refusal is not self._logged and not self.is_choosing:
            self._logged = refusal
            self.log(refusal.reason, "bad")

    def take_posture(self, goal: Vector) -> None:
        """Use other joints (n,) with the tip at the target, if the goal was refused."""
        if goal is not self.goal:
            self.goal = goal
            self.log("The arm will reach this target in another posture.")

    def log(self, message: str, level: str = "") -> None:
        """Append a message; move an earlier equal message to the end."""
        for entry in [each for each in self.messages if each.message == message]:
            self.messages.remove(entry)
        self.messages.append(LogEntry(self._clock.now_s(), message, level))

    def choose_solver(self, name: str) -> None:
        """Select the solver for clicks and drags.

        Raises:
            UnknownNameError: There is no solver of that name.
        """
        if name not in self.solvers:
            raise UnknownNameError("solver", name, self.solvers)
        self._solver.method = name
        self.solver_text = ""

    def set_preference(self, preference: PosturePreference, measured: Vector) -> None:
        """Prefer a posture if the target leaves freedom (null-space motion).

        Raises:
            UnknownNameError: There is no such pose, or no such joint.
        """
        here = self._index.chain_joints(measured)
        self._solver.posture = preference.make_posture(self._arm.model, self._chain, here)
        self.preference = preference
        self.revision += 1

    def set_joint(self, joint: str, value: float, snapshot: ArmSnapshot) -> None:
        """Set the goal of one joint, degrees or mm; other joints keep their goals.

        Raises:
            UnknownNameError: There is no such joint.
            InputError: The position is past a limit; nothing has changed.
        """
        goal = self._ranges.moved(self._goal_or_rest(snapshot), joint, value)
        self._set_goal(goal, snapshot, f"joint {joint}")

    def jog_joint(self, joint: str, step: float, snapshot: ArmSnapshot) -> None:
        """Move the goal of one joint by a step, degrees or mm, at most to its limit.

        Raises:
            UnknownNameError: There is no such joint.
            InputError: The joint is at that limit already; nothing has changed.
        """
        goal = self._ranges.stepped(self._goal_or_rest(snapshot), joint, step)
        self._set_goal(goal, snapshot, f"joint {joint}")

    def set_tool(self, what: str, value: float, snapshot: ArmSnapshot, *, step: bool) -> None:
        """Set one coordinate [mm] or angle [degrees] of the tool, or move it by a step.

        Raises:
            IkservoError: The arm cannot do this; nothing has changed.
        """
        q = self._index.chain_joints(self._goal_or_rest(snapshot))
        wanted = self._tool_targets.values(q)[what] + value if step else value
        self._set_tool_goal(snapshot, *self._tool_targets.solve_value(q, what, wanted))

    def point_tool(self, direction: Vector, snapshot: ArmSnapshot) -> None:
        """Point the tool in a direction (3,) of the base frame; its tip stays.

        Raises:
            IkservoError: The arm cannot do this; nothing has changed.
        """
        q = self._index.chain_joints(self._goal_or_rest(snapshot))
        self._set_tool_goal(snapshot, *self._tool_targets.solve_direction(q, direction))

    def tool_fields(self, measured: Vector) -> dict[str, object]:
        """Return the tool's values at the goal or, without a goal, at the measured joints (n,)."""
        q = self._index.chain_joints(measured if self.goal is None else self.goal)
        return self._tool_targets.fields(q)

    def goal_fields(self, measured: Vector) -> list[float]:
        """Return each joint's goal, or else its measured position (n,), in degrees or mm."""
        shown = measured if self.goal is None else self.goal
        return [
            round(self._ranges.to_shown(column, position), 1)
            for column, position in enumerate(shown.tolist())
        ]

    def range_fields(self) -> list[dict[str, object]]:
        """Return name, unit and range of each joint."""
        return self._ranges.fields()

    def _goal_or_rest(self, snapshot: ArmSnapshot) -> Vector:
        resting = snapshot.measured if snapshot.reference is None else snapshot.reference
        return resting if self.goal is None else self.goal

    def _set_tool_goal(self, snapshot: ArmSnapshot, q: Vector, marker: TargetMarker) -> None:
        self._set_goal(self._index.with_chain(self._goal_or_rest(snapshot), q), snapshot, "tool")
        self.marker = marker

    def undo(self, snapshot: ArmSnapshot) -> None:
        """Go back to the previous goal.

        Raises:
            InputError: There is no such goal.
        """
        self._restore(self.history.undo(self._present_goal(snapshot)))

    def redo(self, snapshot: ArmSnapshot) -> None:
        """Restore the goal that was undone last.

        Raises:
            InputError: There is no such goal.
        """
        self._restore(self.history.redo(self._present_goal(snapshot)))

    def finish_target(self) -> None:
        """End a drag and its solver, and open the hand's clutch; the goal stays as shown."""
        self._drag.cancel()
        self._tool_drag.release()
        self.hand.release()
        self._command = None

    def _restore(self, past: PastGoal) -> None:
        self.reset()
        self.goal, self.marker = past.goal, past.marker

    def _present_goal(self, snapshot: ArmSnapshot) -> PastGoal:
        """Return the goal; in Live without a goal, the present position of the arm."""
        goal = self.goal if snapshot.reference is None else self._goal_or_rest(snapshot)
        return PastGoal(goal, self.marker)

    def _record_goal(self, snapshot: ArmSnapshot, kind: str) -> None:
        self.history.record(self._present_goal(snapshot), kind, self._clock.now_s())

    def _set_goal(self, goal: Vector, snapshot: ArmSnapshot, kind: str) -> None:
        """Set a goal (n,) that did not come from a pointer, and end a drag."""
        self._record_goal(snapshot, kind)
        self.reset()
        self.goal = goal

    def pose(self, name: str, snapshot: ArmSnapshot) -> None:
        """Set a named pose as the goal, clipped to this arm's limits.

        Raises:
            UnknownNameError: The arm has no pose of that name.
        """
        limited = self._arm.pose_within_limits(name, snapshot.measured)
        goal = np.array([limited.positions[joint] for joint in self._index.names])
        self._set_goal(goal, snapshot, "")
        for text in limited.changed:
            self.log(text)

    def handle(
        self, message: Message, context: PointerContext, snapshot: ArmSnapshot, now_s: float
    ) -> None:
        """Handle an input message in the context in which the user gave it."""
        if isinstance(message, msg.Gamepad) and self._gripper is not None:
            if message.grip:
                self._record_goal(snapshot, "gripper")
            goal, column = self._goal_or_rest(snapshot), self._gripper.column
            measured = None if snapshot.reference is None else snapshot.measured
            at = self._gripper.next_position(message.grip, float(goal[column]), measured, now_s)
            if at is not None:
                self.goal = goal.copy()
                self.goal[column] = at
        before = self._present_goal(snapshot)
        command = self._command_from(message, context, now_s)
        self.revision += 1
        if command is None:
            return
        if not isinstance(message, msg.Pointer | msg.DragTool):
            self.history.record(before, type(message).__name__, now_s)
        else:
            if message.phase == "down" or not self._drag_recorded:  # once per drag
                self.history.record(before, "", now_s)
            self._drag_recorded = True
        self._command, self.solver_trace = command, None
        self._solve_pending(snapshot, now_s)

    def track_hand(
        self, message: msg.TrackHand, snapshot: ArmSnapshot, speed: str, now_s: float
    ) -> None:
        """Move the goal with the hand, which ends a drag.

        Raises:
            InputError: The pose is invalid.
        """
        was_held = self.hand.is_held
        self.hand.expire(now_s)
        if self.hand.is_new(message):
            self._record_goal(snapshot, "")
            self.finish_target()
        goal = self._goal_or_rest(snapshot)
        goal, marker = self.hand.next_goal(message, goal, snapshot, speed, now_s)
        if marker is not None:
            self.goal, self.marker, self.solver_trace = goal, marker, None
        if marker is not None or was_held:
            self.revision += 1

    def continue_target(self, snapshot: ArmSnapshot, now_s: float) -> None:
        """Continue towards a target that one solve did not reach; release a hand that is silent."""
        self.hand.expire(now_s)
        if self._command is not None:
            self.revision += 1
            self._solve_pending(snapshot, now_s)

    @property
    def moved_thing(self) -> MovedThing | None:
        """The thing that is dragged, or was dropped last."""
        return self._drag.moved_thing

    def set_things(self, things: Sequence[Obstacle]) -> None:
        """Set the things around the arm that a press may grab."""
        self._drag.set_objects(Picker(thing_shapes(things)))
        self._drag.moved_thing = None

    @property
    def shown_goal(self) -> Vector | None:
        """The joints of the chain (dof,) to show as the goal."""
        return None if self.goal is None else self._index.chain_joints(self.goal)

    def trace_step(self, now_s: float) -> int:
        """Return which step of the solver trace is shown now."""
        if self.solver_trace is None:
            return 0
        return min(int((now_s - self._trace_start_s) * _STEPS_HZ), self.solver_trace.count - 1)

    def _warm_up(self) -> None:
        """Warm up the JIT now instead of at the first input."""
        extent = arm_extent(self._arm.model)
        camera = make_camera(
            extent, Viewpoint(available_views(extent)[0]), Viewport(640.0, 480.0), 0.0
        )
        q = self._chain.mid_range()
        self._drag.hover((320.0, 240.0), PointerContext(camera, (q,)))
        self._solver.solve_command(
            DragTarget(Target(self._chain.forward(q)[:3, 3]), is_click=True), q
        )

    def pointer_context(
        self,
        camera: Camera,
        snapshot: ArmSnapshot,
        plane_m: Vector | None = None,
        surface: PictureSurface | None = None,
    ) -> PointerContext:
        """Return the context of a pointer; ``PointerContext`` describes the arguments."""
        measured = self._index.chain_joints(snapshot.measured)
        goal = self.shown_goal
        arms = (measured,) if goal is None else (goal, measured)
        other_joints = self._index.by_name(snapshot.measured)
        return PointerContext(camera, arms, plane_m, other_joints, surface)

    def _command_from(
        self, message: Message, context: PointerContext, now_s: float
    ) -> DragCommand | None:
        drag = self._drag
        if isinstance(message, msg.Pointer):
            return self._pointer_command(message, context)
        if isinstance(message, msg.DragTool):
            return self._tool_command(message, context)
        if isinstance(message, msg.Wheel):
            return drag.wheel((message.x, message.y), message.notches, context, fine=message.alt)
        if isinstance(message, msg.Key):
            return drag.on_key(message.key, context, fine=message.alt)
        if isinstance(message, msg.SelectBehind) and self._pointer is not None and not drag.is_busy:
            drag.select_next(self._pointer, context, message.step)
            self._update_hover(self._pointer, context)
        if isinstance(message, msg.Gamepad):
            tip_m = self._chain.forward(context.arms[0])[:3, 3]
            return self._gamepad.make_command(message, context.camera, tip_m, now_s)
        return None

    def _pointer_command(self, message: msg.Pointer, context: PointerContext) -> DragCommand | None:
        at = (message.x, message.y)
        if message.phase == "down":
            self._drag_recorded = False
            self._update_hover(at, context)
            self.hover = None
            return self._drag.press(at, context, shift=message.shift, pointer=message.pointer)
        if message.phase == "move":
            return self._drag.move(at, message.pointer)
        if message.phase == "up":
            self._drag.release(message.pointer)
            self._warn_unreached()
        elif message.phase == "cancel":
            self.reset()
        elif message.phase == "leave" and message.touch:
            return None  # a lifted finger keeps the list
        self._update_hover(None if message.phase in ("cancel", "leave") else at, context)
        return None

    def _tool_command(self, message: msg.DragTool, context: PointerContext) -> DragCommand | None:
        if message.phase == "down":
            self._drag_recorded, self._command = False, None
            self._tool_drag.press(context.arms[0])
            self._update_hover(None, context)
        elif message.phase == "move":
            return self._tool_drag.move(np.array(message.shift), np.array(message.turn))
        elif message.phase == "up":
            self._tool_drag.release()
            self._warn_unreached()
        else:
            self.reset()
        return None

    def _update_hover(self, at: tuple[float, float] | None, context: PointerContext) -> None:
        """Update the things under the pointer, and the thing that a press would grab."""
        self._pointer, self.hover, self.under, self.chosen = at, None, (), 0
        if at is not None:
            self.under, self.chosen = self._drag.candidates_under(at, context)
            found = self.under[self.chosen]
            self.hover = found.hit.link if found is not None and found.kind == "link" else None

    def _solve_pending(self, snapshot: ArmSnapshot, now_s: float) -> None:
        command = self._command
        if command is None:
            return
        goal = self._goal_or_rest(snapshot)
        start_s = time.perf_counter()
        q = self._index.chain_joints(goal)
        if self.solver != AUTO and isinstance(command, DragTarget) and command.is_click:
            # Solve a click with the chosen method, and keep its iterations for drawing.
            target_m, posture = command.target.position, self._solver.posture
            self.solver_trace = trace_method(self._chain, target_m, q, self.solver, posture)
            self._trace_start_s = now_s
            found = self.solver_trace.result
            self.marker = TargetMarker(target_m, found.nearest_m, found.reached, found.binding)
            q, is_settled = found.q, True
        else:
            solution = self._solver.solve_command(command, q)
            self.marker, self.solver_text = solution.marker, solution.text
            q, is_settled = solution.q, solution.settled or isinstance(command, JointTarget)
        self.solve_s = time.perf_counter() - start_s
        self.goal = self._index.with_chain(goal, q)
        if is_settled:
            self._command = None
            self._warn_unreached()

    def _warn_unreached(self) -> None:
        """Add a message if the target was not reached, once per gesture, at its end."""
        if (
            self.marker is None
            or self.marker.reached
            or self._is_dragging
            or self._command is not None
        ):
            return
        method = self.solver if self.solver in ITERATIVE else None
        self.log(describe_target(self.marker, method))
