"""What the person in control does, and the goal it leads to."""

from __future__ import annotations

import time
from collections import deque

import numpy as np

from ikservo.arm import Arm
from ikservo.arm.planning import posed_inside
from ikservo.errors import UnknownNameError
from ikservo.ik import Target
from ikservo.kinematics.se3 import Vector
from ikservo.view.camera.camera import Camera, Viewport
from ikservo.view.camera.stage import stage_of
from ikservo.view.camera.views import View, camera_of, views_of
from ikservo.view.drag.drag import Drag, Sight
from ikservo.view.drag.puppet import AUTO, Puppet
from ikservo.view.drag.wishes import Pull, Turn, Wish
from ikservo.view.pick.pick import Picker
from ikservo.view.pick.shapes import capsules_of, objects_of, shapes_of
from ikservo.view.pick.under import Found
from ikservo.view.scene.aim import Aim
from ikservo.view.scene.planar import CHOICES, ITERATIVE, Lesson, teach
from ikservo.view.scene.texts import aim_words
from ikservo.view.server import messages as said
from ikservo.view.server.messages import Message
from ikservo.view.session.jaws import Jaws, jaws_of
from ikservo.view.session.preference import Preference
from ikservo.view.session.readout import Readout
from ikservo.view.session.sticks import Sticks

__all__ = ["Gestures"]

_STEPS_HZ = 30.0
_MOST_COMPLAINTS = 6


class Gestures:
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
        lesson: What a method of the lecture did on the last click, to be drawn step by step.
        complaints: What became of targets that are out of reach, the oldest first.
        stamp: Changes whenever the picture has to.
    """

    def __init__(self, arm: Arm) -> None:
        chain = arm.chain
        self._arm, self._chain = arm, chain
        names = [joint.name for joint in arm.model.joints]
        self._names = names
        self._columns = [names.index(name) for name in chain.names]
        picker = Picker(shapes_of(capsules_of(arm.model)))
        self._drag = Drag(chain, picker, Picker(objects_of(arm.model)))
        self._puppet, self._sticks = Puppet(chain), Sticks()
        self._jaws = jaws_of(arm)
        self._wish: Wish | None = None
        self.lesson: Lesson | None = None
        self._began_s = 0.0
        self.goal: Vector | None = None
        self.aim: Aim | None = None
        self.hover: str | None = None
        self.under: tuple[Found | None, ...] = ()
        self.chosen = 0
        self._pointer: tuple[float, float] | None = None
        self.solve_s: float | None = None
        self.solver_words = ""
        self.preference = Preference()
        self.complaints: deque[str] = deque(maxlen=_MOST_COMPLAINTS)
        self.stamp = 0
        self._warm_up()

    @property
    def camera(self) -> Camera | None:
        """Return the camera to keep while something is held."""
        return self._drag.camera

    @property
    def grabbed(self) -> str | None:
        """Return the link that is being pulled."""
        return self._drag.grabbed

    @property
    def picked(self) -> str | None:
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
        return [AUTO, *CHOICES]

    def forget(self) -> None:
        """Let go of everything: the goal is where the arm is."""
        self._drag.cancel()
        self._wish = self.goal = self.aim = self.lesson = None
        self.stamp += 1

    def choose_solver(self, name: str) -> None:
        """Let clicks and drags be answered by a solver.

        Raises:
            UnknownNameError: There is none of that name.
        """
        if name not in self.solvers:
            raise UnknownNameError("solver", name, self.solvers)
        self._puppet.method = name
        self.solver_words = ""

    def prefer(self, preference: Preference, measured: Vector) -> None:
        """Lean towards a posture where the target leaves freedom (lecture L10).

        Raises:
            UnknownNameError: There is no such pose, or no such joint.
        """
        here = measured[self._columns]
        self._puppet.posture = preference.posture(self._arm.model, self._chain, here)
        self.preference = preference
        self.stamp += 1

    def pose(self, name: str, measured: Vector) -> None:
        """Go to a named pose, inside this arm's limits, from where its joints are (n,).

        Raises:
            UnknownNameError: The arm has none of that name.
        """
        inside = posed_inside(
            name, self._arm.model.pose(name), self._arm.workings.servos.fences, measured
        )
        self.forget()
        self.goal = np.array([inside.positions[joint] for joint in self._names])
        self.complaints.extend(words for words in inside.changed if words not in self.complaints)

    def hear(self, message: Message, sight: Sight, readout: Readout, now_s: float) -> None:
        """Take what pointer, wheel, keys or sticks say of what the person sees."""
        if isinstance(message, said.Gamepad) and self._jaws is not None:
            self._grip(self._jaws, message.grip, readout, now_s)
        wish = self._wished(message, sight, now_s)
        self.stamp += 1
        if wish is not None:
            self._wish, self.lesson = wish, None
            self._answer(readout, now_s)

    def go_on(self, readout: Readout, now_s: float) -> None:
        """Come nearer to a wish that one answer was not enough for."""
        if self._wish is not None:
            self.stamp += 1
            self._answer(readout, now_s)

    @property
    def shown_goal(self) -> Vector | None:
        """Return the joints of the chain (dof,) to show as the goal."""
        return None if self.goal is None else self.goal[self._columns]

    def step(self, now_s: float) -> int:
        """Return which of the lesson's steps is shown now: they are drawn as they went."""
        if self.lesson is None:
            return 0
        return min(int((now_s - self._began_s) * _STEPS_HZ), self.lesson.count - 1)

    def _warm_up(self) -> None:
        """Load what is compiled now, not while the first person waits."""
        stage = stage_of(self._arm.model)
        camera = camera_of(stage, View(views_of(stage)[0]), Viewport(640.0, 480.0), 0.0)
        q = self._chain.middle()
        self._drag.hover((320.0, 240.0), Sight(camera, (q,)))
        self._puppet.answer(Pull(Target(self._chain.forward(q)[:3, 3]), jump=True), q)

    def sight(self, camera: Camera, readout: Readout, plane_m: Vector | None = None) -> Sight:
        """Return what the person has before them; ``plane_m`` see ``Sight``."""
        measured = readout.measured[self._columns]
        arms = (measured,) if self.goal is None else (self.goal[self._columns], measured)
        beside = dict(zip(self._names, readout.measured.tolist(), strict=True))
        return Sight(camera, arms, plane_m, beside)

    def _grip(self, jaws: Jaws, grip: float, readout: Readout, now_s: float) -> None:
        """Close or open the jaws for as long as somebody keeps pressing."""
        goal = self._rest(readout) if self.goal is None else self.goal
        at = jaws.goal(grip, float(goal[jaws.column]), readout.measured, now_s)
        if at is not None:
            self.goal = goal.copy()
            self.goal[jaws.column] = at

    def _rest(self, readout: Readout) -> Vector:
        return readout.measured if readout.goals is None else readout.goals

    def _wished(self, message: Message, sight: Sight, now_s: float) -> Wish | None:
        drag = self._drag
        if isinstance(message, said.Pointer):
            return self._pointed(message, sight)
        if isinstance(message, said.Wheel):
            return drag.wheel((message.x, message.y), message.notches, sight, fine=message.alt)
        if isinstance(message, said.Key):
            return drag.key(message.key, sight, fine=message.alt)
        if isinstance(message, said.Behind):
            self._choose(message.step, sight)
        if isinstance(message, said.Gamepad):
            tip_m = self._chain.forward(sight.arms[0])[:3, 3]
            return self._sticks.wish(message, sight.camera, tip_m, now_s)
        return None

    def _pointed(self, message: said.Pointer, sight: Sight) -> Wish | None:
        at = (message.x, message.y)
        if message.phase == "down":
            self._look_under(at, sight)
            self.hover = None
            return self._drag.press(at, sight, shift=message.shift, pointer=message.pointer)
        if message.phase == "move":
            return self._drag.move(at, message.pointer)
        if message.phase == "up":
            self._drag.release(message.pointer)
            self._complain()
        elif message.phase == "cancel":
            self.forget()
        elif message.phase == "leave" and message.touch:
            return None  # a finger that was lifted leaves its list behind
        self._look_under(None if message.phase in ("cancel", "leave") else at, sight)
        return None

    def _look_under(self, at: tuple[float, float] | None, sight: Sight) -> None:
        """Notice what is under the pointer, and which of it a press would grab."""
        self._pointer, self.hover, self.under, self.chosen = at, None, (), 0
        if at is not None:
            self.under, self.chosen = self._drag.under(at, sight)
            found = self.under[self.chosen]
            self.hover = found.hit.link if found is not None and found.kind == "link" else None

    def _choose(self, step: int, sight: Sight) -> None:
        if self._pointer is not None and not self._drag.busy:
            self._drag.go_on(self._pointer, sight, step)
            self._look_under(self._pointer, sight)

    def _answer(self, readout: Readout, now_s: float) -> None:
        wish = self._wish
        if wish is None:
            return
        goal = self._rest(readout) if self.goal is None else self.goal
        began_s = time.perf_counter()
        q, settled = self._answered(wish, goal[self._columns], now_s)
        self.solve_s = time.perf_counter() - began_s
        self.goal = goal.copy()
        self.goal[self._columns] = q
        if settled:
            self._wish = None
            self._complain()

    def _answered(self, wish: Wish, q: Vector, now_s: float) -> tuple[Vector, bool]:
        """Return the chain's goal (dof,), and whether the wish leads no further."""
        if self.solver != AUTO and isinstance(wish, Pull) and wish.jump:
            return self._by_method(wish, q, now_s), True
        answer = self._puppet.answer(wish, q)
        self.aim, self.solver_words = answer.aim, answer.words
        return answer.q, answer.settled or isinstance(wish, Turn)

    def _by_method(self, wish: Pull, q: Vector, now_s: float) -> Vector:
        """Let a method of the lecture answer a click, and keep its iterations to be drawn."""
        posture = self._puppet.posture
        self.lesson = teach(self._chain, wish.target.position, q, self.solver, posture)
        self._began_s = now_s
        found = self.lesson.result
        self.aim = Aim(wish.target.position, found.nearest_m, found.reached, found.binding)
        return found.q

    def _complain(self) -> None:
        """Say that a target is not reached, once for each gesture and not before its end."""
        if self.aim is None or self.aim.reached or self._drag.busy or self._wish is not None:
            return
        method = self.solver if self.solver in ITERATIVE else None
        words = aim_words(self.aim, method)
        if words not in self.complaints:
            self.complaints.append(words)
