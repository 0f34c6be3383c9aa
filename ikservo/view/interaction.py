"""User input to goals: pointer gestures, gripper buttons, gamepad sticks, preferred posture."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ikservo.arm import Arm
from ikservo.arm.plan import posed_inside
from ikservo.errors import UnknownNameError
from ikservo.ik import Posture, Target
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Vector
from ikservo.model import Model
from ikservo.model.collision_model import capsules_of
from ikservo.view import messages as said
from ikservo.view.bvh import link_primitives, object_primitives
from ikservo.view.camera import Camera, Viewport
from ikservo.view.drag import Drag
from ikservo.view.drag_solver import AUTO, DragSolver
from ikservo.view.draw_items import TargetMarker
from ikservo.view.labels import describe_target
from ikservo.view.messages import DragCommand, DragTarget, Gamepad, JointTarget, Message
from ikservo.view.picking import PickCandidate, Picker, PointerContext
from ikservo.view.snapshot import ArmSnapshot
from ikservo.view.solver_demo import ITERATIVE, SOLVERS, SolverTrace, trace_method
from ikservo.view.viewpoints import Viewpoint, arm_extent, available_views, make_camera

__all__ = [
    "CURRENT_POSTURE",
    "NONE",
    "GamepadControl",
    "GripperControl",
    "Interaction",
    "PosturePreference",
    "gripper_control",
]


_FULL_TRAVEL_S = 1.5  # from closed to open
_LEAD_FRACTION = 0.06  # of the range: so far goals lead jaws that something keeps apart
_MAX_GRIP_STEP_S = 0.1  # between two messages; after more the thumb was lifted


class GripperControl:
    """Remembers since when they are being moved.

    Args:
        column: The gripper's entry among all joints.
        closed: Where the jaws meet, rad or m.
        opened: Where they are furthest apart.
    """

    def __init__(self, column: int, closed: float, opened: float) -> None:
        self.column = column
        self._closed, self._opened = closed, opened
        self._last_s = -1e9

    def next_position(
        self, grip: float, goal: float, measured: Vector, now_s: float
    ) -> float | None:
        """Return where the joint shall go, rad or m; None while nobody presses.

        Args:
            grip: 1 closes, -1 opens, less does it more slowly.
            goal: Where it was to go so far.
            measured: Where all joints are (n,).
            now_s: The time.
        """
        elapsed_s, self._last_s = min(now_s - self._last_s, _MAX_GRIP_STEP_S), now_s
        if not grip:
            return None
        whole = self._closed - self._opened
        at, ahead = float(measured[self.column]), abs(whole) * _LEAD_FRACTION
        wanted = goal + grip * whole * elapsed_s / _FULL_TRAVEL_S
        wanted = min(max(wanted, at - ahead), at + ahead)
        low, high = sorted((self._closed, self._opened))
        return min(max(wanted, low), high)


def gripper_control(arm: Arm) -> GripperControl | None:
    """Return the gripper of an arm, inside its calibrated limits; None where it has none."""
    gripper = arm.model.gripper
    if gripper is None:
        return None
    column = [joint.name for joint in arm.model.joints].index(gripper.joint)
    lower, upper = arm.workings.limits()
    low, high = float(lower[column]), float(upper[column])
    ends = (min(max(end, low), high) for end in (gripper.closed, gripper.open))
    return GripperControl(column, *ends)


_SPEED_M_S = 0.12
_MAX_STICK_STEP_S = 0.1  # between two messages; after more the sticks were let go
_LEAD_M = 0.05  # a target that the arm cannot follow does not run away


class GamepadControl:
    """Remembers where the sticks have brought the target."""

    def __init__(self) -> None:
        self._target_m: Vector | None = None
        self._last_s = -1e9

    def make_command(
        self, message: Gamepad, camera: Camera, tip_m: Vector, now_s: float
    ) -> DragTarget | None:
        """Return where the tip shall go now.

        Args:
            message: How far the sticks are held over.
            camera: What the person sees: right, up and towards them are those of the screen.
            tip_m: Where the goal so far has the tip (3,).
            now_s: The time.
        """
        elapsed_s, self._last_s = now_s - self._last_s, now_s
        x, y, _, towards = message.axes
        if not (x or y or towards):
            self._target_m = None
            return None
        if self._target_m is None or elapsed_s > _MAX_STICK_STEP_S:
            self._target_m = tip_m
            elapsed_s = min(elapsed_s, _MAX_STICK_STEP_S)
        way = camera.R_world_view @ np.array([x, y, -towards]) * (_SPEED_M_S * elapsed_s)
        target = self._target_m + way
        lead = target - tip_m
        far = float(np.linalg.norm(lead))
        self._target_m = target if far <= _LEAD_M else tip_m + lead * (_LEAD_M / far)
        return DragTarget(Target(self._target_m))


NONE, CURRENT_POSTURE = "none", "here"
"""No posture; the one the arm has when it is chosen."""

_LEANING_METHODS = ("auto", "pseudo_inverse")


@dataclass(frozen=True, slots=True)
class PosturePreference:
    """A preferred pose and how strongly each joint leans towards it.

    Attributes:
        pose: ``none``, ``here`` or the name of a pose of the arm.
        weights: Of joints that do not lean with 1; 0 leaves a joint alone.
    """

    pose: str = NONE
    weights: Mapping[str, float] = field(default_factory=dict[str, float])

    def make_posture(self, model: Model, chain: Chain, here: Vector) -> Posture | None:
        """Return it in joints.

        Args:
            model: Has the poses.
            chain: The joints that lean.
            here: Where they are now (dof,).

        Raises:
            UnknownNameError: No such pose, or no such joint.
        """
        for name in self.weights:
            if name not in chain.names:
                raise UnknownNameError("joint", name, chain.names)
        if self.pose == NONE:
            return None
        q = here.copy() if self.pose == CURRENT_POSTURE else model.chain_pose(self.pose)
        return Posture(q, np.array([self.weights.get(name, 1.0) for name in chain.names]))

    def page_fields(self, solver: str) -> dict[str, object]:
        """Return it for the page, and whether the chosen solver leans towards it at all."""
        idle = self.pose != NONE and solver not in _LEANING_METHODS
        note = f"{solver} has no null space: it does not lean." if idle else ""
        return {"pose": self.pose, "weights": dict(self.weights), "note": note}


_STEPS_HZ = 30.0
_MAX_WARNINGS = 6


class Interaction:
    """Turns messages into the goal of all joints; without one the arm stays where it is.

    Args:
        arm: What can be grabbed, inside its own limits.

    Attributes:
        goal: Where all joints shall be (n,), rad or m; None where they are.
        aim: The target behind it, if there is one.
        hover: The link that a press would grab.
        under: All that is under the pointer, None for the plane where the tip would go.
        chosen: Which of them a press means.
        solve_s: How long the last answer took.
        solver_words: What the lecture's method has done in the drag so far.
        preference: The posture to lean towards.
        solver_trace: What a method of the lecture did on the last click, to be drawn step by step.
        messages: What became of targets that are out of reach, the oldest first.
        revision: Changes whenever the picture has to.
    """

    def __init__(self, arm: Arm) -> None:
        chain = arm.chain
        self._arm, self._chain = arm, chain
        names = [joint.name for joint in arm.model.joints]
        self._names = names
        self._columns = [names.index(name) for name in chain.names]
        picker = Picker(link_primitives(capsules_of(arm.model)))
        self._drag = Drag(chain, picker, Picker(object_primitives(arm.model)))
        self._puppet, self._sticks = DragSolver(chain), GamepadControl()
        self._jaws = gripper_control(arm)
        self._wish: DragCommand | None = None
        self.solver_trace: SolverTrace | None = None
        self._began_s = 0.0
        self.goal: Vector | None = None
        self.aim: TargetMarker | None = None
        self.hover: str | None = None
        self.under: tuple[PickCandidate | None, ...] = ()
        self.chosen = 0
        self._pointer: tuple[float, float] | None = None
        self.solve_s: float | None = None
        self.solver_words = ""
        self.preference = PosturePreference()
        self.messages: deque[str] = deque(maxlen=_MAX_WARNINGS)
        self.revision = 0
        self._warm_up()

    @property
    def camera(self) -> Camera | None:
        """Return the camera to keep while something is held."""
        return self._drag.camera

    @property
    def grabbed_link(self) -> str | None:
        """Return the link that is being pulled."""
        return self._drag.grabbed_link

    @property
    def picked_object(self) -> str | None:
        """Return the object of the scene that a press would pick."""
        found = self.under[self.chosen] if self.under else None
        return found.hit.link if found is not None and found.kind == "object" else None

    @property
    def solver(self) -> str:
        """Return the solver that answers: ``auto``, or one of the lecture's methods."""
        return self._puppet.method

    @property
    def solvers(self) -> list[str]:
        """Return the solvers to choose from."""
        return [AUTO, *SOLVERS]

    def reset(self) -> None:
        """Let go of everything: the goal is where the arm is."""
        self._drag.cancel()
        self._wish = self.goal = self.aim = self.solver_trace = None
        self.revision += 1

    def choose_solver(self, name: str) -> None:
        """Let clicks and drags be answered by a solver.

        Raises:
            UnknownNameError: There is none of that name.
        """
        if name not in self.solvers:
            raise UnknownNameError("solver", name, self.solvers)
        self._puppet.method = name
        self.solver_words = ""

    def set_preference(self, preference: PosturePreference, measured: Vector) -> None:
        """Lean towards a posture where the target leaves freedom (lecture L10).

        Raises:
            UnknownNameError: There is no such pose, or no such joint.
        """
        here = measured[self._columns]
        self._puppet.posture = preference.make_posture(self._arm.model, self._chain, here)
        self.preference = preference
        self.revision += 1

    def pose(self, name: str, measured: Vector) -> None:
        """Go to a named pose, inside this arm's limits, from where its joints are (n,).

        Raises:
            UnknownNameError: The arm has none of that name.
        """
        inside = posed_inside(
            name, self._arm.model.pose(name), self._arm.workings.servos.fences, measured
        )
        self.reset()
        self.goal = np.array([inside.positions[joint] for joint in self._names])
        self.messages.extend(words for words in inside.changed if words not in self.messages)

    def handle(
        self, message: Message, sight: PointerContext, readout: ArmSnapshot, now_s: float
    ) -> None:
        """Take what pointer, wheel, keys or sticks say of what the person sees."""
        if isinstance(message, said.Gamepad) and self._jaws is not None:
            self._drive_gripper(self._jaws, message.grip, readout, now_s)
        wish = self._command_from(message, sight, now_s)
        self.revision += 1
        if wish is not None:
            self._wish, self.solver_trace = wish, None
            self._solve_pending(readout, now_s)

    def continue_target(self, readout: ArmSnapshot, now_s: float) -> None:
        """Come nearer to a wish that one answer was not enough for."""
        if self._wish is not None:
            self.revision += 1
            self._solve_pending(readout, now_s)

    @property
    def shown_goal(self) -> Vector | None:
        """Return the joints of the chain (dof,) to show as the goal."""
        return None if self.goal is None else self.goal[self._columns]

    def trace_step(self, now_s: float) -> int:
        """Return which of the lesson's steps is shown now: they are drawn as they went."""
        if self.solver_trace is None:
            return 0
        return min(int((now_s - self._began_s) * _STEPS_HZ), self.solver_trace.count - 1)

    def _warm_up(self) -> None:
        """Load what is compiled now, not while the first person waits."""
        stage = arm_extent(self._arm.model)
        camera = make_camera(
            stage, Viewpoint(available_views(stage)[0]), Viewport(640.0, 480.0), 0.0
        )
        q = self._chain.mid_range()
        self._drag.hover((320.0, 240.0), PointerContext(camera, (q,)))
        self._puppet.solve_command(
            DragTarget(Target(self._chain.forward(q)[:3, 3]), is_click=True), q
        )

    def sight(
        self, camera: Camera, readout: ArmSnapshot, plane_m: Vector | None = None
    ) -> PointerContext:
        """Return what the person has before them; ``plane_m`` see ``PointerContext``."""
        measured = readout.measured[self._columns]
        arms = (measured,) if self.goal is None else (self.goal[self._columns], measured)
        beside = dict(zip(self._names, readout.measured.tolist(), strict=True))
        return PointerContext(camera, arms, plane_m, beside)

    def _drive_gripper(
        self, jaws: GripperControl, grip: float, readout: ArmSnapshot, now_s: float
    ) -> None:
        """Close or open the jaws for as long as somebody keeps pressing."""
        goal = self._resting_joints(readout) if self.goal is None else self.goal
        at = jaws.next_position(grip, float(goal[jaws.column]), readout.measured, now_s)
        if at is not None:
            self.goal = goal.copy()
            self.goal[jaws.column] = at

    def _resting_joints(self, readout: ArmSnapshot) -> Vector:
        return readout.measured if readout.goals is None else readout.goals

    def _command_from(
        self, message: Message, sight: PointerContext, now_s: float
    ) -> DragCommand | None:
        drag = self._drag
        if isinstance(message, said.Pointer):
            return self._pointer_command(message, sight)
        if isinstance(message, said.Wheel):
            return drag.wheel((message.x, message.y), message.notches, sight, fine=message.alt)
        if isinstance(message, said.Key):
            return drag.on_key(message.key, sight, fine=message.alt)
        if isinstance(message, said.SelectBehind):
            self._select_candidate(message.step, sight)
        if isinstance(message, said.Gamepad):
            tip_m = self._chain.forward(sight.arms[0])[:3, 3]
            return self._sticks.make_command(message, sight.camera, tip_m, now_s)
        return None

    def _pointer_command(self, message: said.Pointer, sight: PointerContext) -> DragCommand | None:
        at = (message.x, message.y)
        if message.phase == "down":
            self._update_hover(at, sight)
            self.hover = None
            return self._drag.press(at, sight, shift=message.shift, pointer=message.pointer)
        if message.phase == "move":
            return self._drag.move(at, message.pointer)
        if message.phase == "up":
            self._drag.release(message.pointer)
            self._warn_unreached()
        elif message.phase == "cancel":
            self.reset()
        elif message.phase == "leave" and message.touch:
            return None  # a finger that was lifted leaves its list behind
        self._update_hover(None if message.phase in ("cancel", "leave") else at, sight)
        return None

    def _update_hover(self, at: tuple[float, float] | None, sight: PointerContext) -> None:
        """Notice what is under the pointer, and which of it a press would grab."""
        self._pointer, self.hover, self.under, self.chosen = at, None, (), 0
        if at is not None:
            self.under, self.chosen = self._drag.candidates_under(at, sight)
            found = self.under[self.chosen]
            self.hover = found.hit.link if found is not None and found.kind == "link" else None

    def _select_candidate(self, step: int, sight: PointerContext) -> None:
        if self._pointer is not None and not self._drag.is_busy:
            self._drag.select_next(self._pointer, sight, step)
            self._update_hover(self._pointer, sight)

    def _solve_pending(self, readout: ArmSnapshot, now_s: float) -> None:
        wish = self._wish
        if wish is None:
            return
        goal = self._resting_joints(readout) if self.goal is None else self.goal
        began_s = time.perf_counter()
        q, settled = self._solve_command(wish, goal[self._columns], now_s)
        self.solve_s = time.perf_counter() - began_s
        self.goal = goal.copy()
        self.goal[self._columns] = q
        if settled:
            self._wish = None
            self._warn_unreached()

    def _solve_command(self, wish: DragCommand, q: Vector, now_s: float) -> tuple[Vector, bool]:
        """Return the chain's goal (dof,), and whether the wish leads no further."""
        if self.solver != AUTO and isinstance(wish, DragTarget) and wish.is_click:
            return self._solve_by_method(wish, q, now_s), True
        answer = self._puppet.solve_command(wish, q)
        self.aim, self.solver_words = answer.aim, answer.words
        return answer.q, answer.settled or isinstance(wish, JointTarget)

    def _solve_by_method(self, wish: DragTarget, q: Vector, now_s: float) -> Vector:
        """Let a method of the lecture answer a click, and keep its iterations to be drawn."""
        posture = self._puppet.posture
        self.solver_trace = trace_method(self._chain, wish.target.position, q, self.solver, posture)
        self._began_s = now_s
        found = self.solver_trace.result
        self.aim = TargetMarker(wish.target.position, found.nearest_m, found.reached, found.binding)
        return found.q

    def _warn_unreached(self) -> None:
        """Say that a target is not reached, once for each gesture and not before its end."""
        if self.aim is None or self.aim.reached or self._drag.is_busy or self._wish is not None:
            return
        method = self.solver if self.solver in ITERATIVE else None
        words = describe_target(self.aim, method)
        if words not in self.messages:
            self.messages.append(words)
