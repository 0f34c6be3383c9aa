"""The things around an arm while a program runs, which can be added, removed or held."""

from __future__ import annotations

import threading
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from ikservo.arguments import parse_name
from ikservo.arm.motion_runner import MotionRunner
from ikservo.arm.other_arm import OtherArm
from ikservo.errors import BadValueError, RefusedError, UnknownNameError, shown
from ikservo.guard.sag import Sag, arm_sag
from ikservo.kinematics.arrays import Matrix, bounded_vector, finite_vector
from ikservo.kinematics.collision_body import CollisionBody
from ikservo.kinematics.se3 import make_pose, rotation_rpy
from ikservo.model.arm_model import Obstacle
from ikservo.model.collision_capsules import collision_body_with_gripper
from ikservo.model.scene_file import (
    FURTHEST_BASE_M,
    KINDS,
    NEAREST_BASE_M,
    KeepOutShape,
    describe_thing,
    make_shape,
    read_scene,
)
from ikservo.planning.context import ArmContext
from ikservo.planning.surroundings import Turn

_LARGEST_M = 0.5  # half the size of the largest thing that can be held, in each direction
_NAME = "The name of the thing"
_WAIT_S = 2.0  # enough for a reading to end, not for a motion
_POLL_S = 0.02  # time in which a change notices that a motion has begun
_others_lock = threading.RLock()  # both scenes name arms in reach of each other


class InScene(Protocol):
    """An arm of this program that has a scene."""

    @property
    def scene(self) -> Scene:
        """The things around the arm."""
        ...


class Scene:
    """Things around an arm, in its base frame, and things that its gripper holds.

    A new scene contains the things in the arm file and the scene file. Motions that are planned
    later avoid them; an earlier plan is checked again when it is executed. Things may change while
    a planned motion runs: the arm stops in front of an obstacle in its path.

    Args:
        context: The arm.
        runner: Runs the arm's motions.
    """

    def __init__(self, context: ArmContext, runner: MotionRunner) -> None:
        self._context, self._runner = context, runner
        self._things_lock = threading.RLock()
        self._things: dict[str, Obstacle] = {each.name: each for each in context.model.keep_out}
        self._held: dict[str, KeepOutShape] = {}
        self._body: tuple[CollisionBody, Sag | None] | None = None  # includes the held things
        self._others: dict[Scene, OtherArm] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the things around the arm, and of the other arms."""
        return (*self._things, *(other.name for other in self._others.values()))

    @property
    def held(self) -> tuple[str, ...]:
        """Names of the things that the gripper holds."""
        return tuple(self._held)

    @property
    def arms(self) -> tuple[OtherArm, ...]:
        """The other arms in reach."""
        return tuple(self._others.values())

    @property
    def things(self) -> tuple[Obstacle, ...]:
        """The things around the arm, with names and extents."""
        return tuple(self._things.values())

    if not TYPE_CHECKING:  # a type checker reports an unknown name itself

        def __getattr__(self, name: str) -> None:
            kind = name.removeprefix("add_")
            thing = f'"{kind if kind in KINDS else "box"}", "its name"'
            hint = f"To add a thing: arm.scene.add({thing}, center_m=(x, y, z), ...)"
            raise AttributeError(f"A scene has no {name!r}. {hint}")

    def __repr__(self) -> str:
        """Show the names of all things."""
        return f"Scene({', '.join(self.names)}; held: {', '.join(self.held) or 'nothing'})"

    def add(self, kind: str, name: str, **sizes: Any) -> None:  # noqa: ANN401  # keys of a file
        """Add a thing, with the keys that it has in a scene file.

        ``arm.scene.add("box", "the shelf", center_m=(0.3, 0.2, 0.1), size_m=(0.2, 0.1, 0.02))``

        Args:
            kind: box, cylinder, sphere or half_space.
            name: Name for messages; unique among things and links.
            sizes: The values of the thing's other keys.

        Raises:
            UnknownNameError: There is no such kind.
            BadValueError: The name is taken.
            FileFormatError: A value is missing, unknown or of the wrong type; the message names the
                key.
            RefusedError: A motion without a plan is running.
        """
        with self._changing_things():
            self._check_new(name)
            self._change({**self._things, name: make_shape(kind, name, sizes)}, self._held)

    def change(self, name: str, /, **sizes: Any) -> None:  # noqa: ANN401  # keys of a file
        """Change a thing around the arm: its place, its size or its name.

        ``arm.scene.change("the shelf", center_m=(0.3, 0.25, 0.1))``

        For another arm, give its place: ``at_m`` and ``rpy_deg``, as for ``add_arm``.

        Raises:
            UnknownNameError: There is no such thing.
            BadValueError: The new name is taken.
            FileFormatError: A value is unknown or of the wrong type; the message names the key.
            RefusedError: A motion without a plan is running.
        """
        other = self._find_arm(parse_name(_NAME, name))
        if other is not None:
            self._place_arm(other, sizes)
            return
        with self._changing_things():
            if name not in self._things:
                raise UnknownNameError("thing", name, self._things)
            kind, present = describe_thing(self._things[name])
            values = {**present, **sizes}
            new_name = str(values.pop("name", name))
            if new_name != name:
                self._check_new(new_name)
            changed = make_shape(kind, new_name, values)
            listed = [changed if key == name else each for key, each in self._things.items()]
            self._change({each.name: each for each in listed}, self._held)

    def load(self, path: Path | str) -> None:
        """Add the things in a scene file.

        Raises:
            FileFormatError: The file is malformed.
            BadValueError: A name is taken.
            RefusedError: A motion without a plan is running, or the file has another arm; see
                ``add_arm``.
        """
        added = {each.name: each for each in read_scene(path)}
        with self._changing_things():
            for name in added:
                self._check_new(name)
            self._change({**self._things, **added}, self._held)

    def is_of_same_arm(self, other: Scene) -> bool:
        """Check whether a scene belongs to the same arm: same file, and same adapter or port."""
        one, another = (
            (each.model.path, each.serial_number or each.port.name)
            for each in (self._context, other._context)
        )
        return one == another

    def take_over(self, before: Scene) -> None:
        """Copy the things and other arms from a previous scene of the same arm.

        Raises:
            RefusedError: A motion is running, or an arm was opened without collision checks.
        """
        with self._changing(), _others_lock:
            if before._things != self._things or before._held or before._others:
                self._change(before._things, before._held)
            for scene, there in before._others.items():
                here = replace(
                    scene._others[before], context=self._context, runner=self._runner, left=None
                )
                # This arm's last seen position stays until the next look, as it may be moving.
                scene._others = {
                    **{k: v for k, v in scene._others.items() if k is not before},
                    self: here,
                }
                scene._context.surroundings.others = tuple(scene._others.values())
                self._others[scene] = there
            before._others = {}
            self._context.surroundings.set_others(tuple(self._others.values()))

    def add_arm(
        self,
        other: InScene,
        name: str,
        at_m: ArrayLike,
        rpy_deg: ArrayLike = (0.0, 0.0, 0.0),
        *,
        own_name: str | None = None,
    ) -> None:
        """Add another arm of this program, and this arm to its scene.

        From then on, only one of the two arms moves at a time, and it avoids the other arm. The
        other arm is assumed to stay where it was at the beginning of the motion, or when it was
        closed, even if a person moves it by hand.

        ``left.scene.add_arm(right, "right", at_m=(0.0, -0.4, 0.0))``

        Args:
            other: The other arm, open and calibrated.
            name: Name for messages; unique among things and links.
            at_m: The origin (3,) of the other arm's base frame in this arm's base frame.
            rpy_deg: Roll, pitch and yaw (3,) of that frame, also in this arm's base frame.
            own_name: Name of this arm in the other scene; None uses the name of its model.

        Raises:
            BadValueError: The name is taken, the place is not valid or equals this arm's place, or
                ``other`` is not another arm.
            RefusedError: One of the arms is moving, its position is unknown, or its paths are not
                checked for collisions.
        """
        scene = getattr(other, "scene", None)
        if not isinstance(scene, Scene) or scene is self or scene in self._others:
            raise BadValueError(
                "The arm to add", other, "another arm of this program, not yet added"
            )
        T = _pose_of_base(at_m, rpy_deg)
        with self._changing_both(scene):
            self._check_new(name)
            own_name = parse_name(_NAME, own_name or self._context.model.name)
            while own_name in {*scene.names, *scene.held, *scene._context.chain.frames}:
                own_name = f"another {own_name}"
            turn = Turn()
            there = OtherArm(name, scene._context, scene._runner, T, turn)
            here = OtherArm(own_name, self._context, self._runner, _inverse(T), turn)
            for each in (there, here):
                each.things(self)  # raises if its position is unknown
            self._change_others({**self._others, scene: there})
            scene._change_others({**scene._others, self: here})

    def _place_arm(self, other: Scene, sizes: dict[str, Any]) -> None:
        present = self._others[other].placed
        if unknown := sizes.keys() - {"at_m", "rpy_deg"}:
            raise UnknownNameError("placement field", min(unknown), ["at_m", "rpy_deg"])
        T = _pose_of_base(sizes.get("at_m", present.at_m), sizes.get("rpy_deg", present.rpy_deg))
        with self._changing_both(other):
            for one, another, pose in ((self, other, T), (other, self, _inverse(T))):
                moved = replace(one._others[another], T_base_other=pose)
                if moved.left is not None:
                    back = pose @ _inverse(one._others[another].T_base_other)
                    moved.left = [each.moved(back) for each in moved.left]
                one._change_others({**one._others, another: moved})

    def remove(self, name: str) -> None:
        """Remove a thing, which may be held, or another arm.

        Raises:
            UnknownNameError: There is no such thing.
            RefusedError: A motion without a plan is running.
        """
        other = self._find_arm(parse_name(_NAME, name))
        if other is not None:
            with self._changing_both(other):
                for one, another in ((self, other), (other, self)):
                    one._change_others({k: v for k, v in one._others.items() if k is not another})
            return
        with self._changing() if name in self._held else self._changing_things():
            if name not in self._things and name not in self._held:
                raise UnknownNameError("thing", name, [*self.names, *self._held])
            things, held = dict(self._things), dict(self._held)
            things.pop(name, None)
            held.pop(name, None)
            self._change(things, held)

    def attach(self, name: str) -> None:
        """Treat a thing as held by the gripper at its present place: the thing moves with the tip.

        The thing is checked as a part of the arm until it is released; opening the gripper releases
        it, too. Its weight counts as the payload in the arm file, for which sag is compensated.

        Raises:
            UnknownNameError: There is no such thing.
            BadValueError: The thing is a box of the arm file or a half-space, or too large.
            RefusedError: A motion is running.
        """
        parse_name(_NAME, name)
        with self._changing():
            if name not in self._things:
                raise UnknownNameError("thing", name, self._things)
            thing, things = self._things[name], dict(self._things)
            if not isinstance(thing, KeepOutShape) or thing.half_size_m.max() > _LARGEST_M:
                expected = f"a scene thing, at most {2.0 * _LARGEST_M:g} m long, wide and high"
                raise BadValueError("The thing to hold", name, expected)
            del things[name]
            self._change(things, {**self._held, name: thing.moved(_inverse(self._tip_pose()))})

    def release(self, name: str | None = None) -> None:
        """Release a held thing at its present place; None releases all things.

        Raises:
            UnknownNameError: The gripper does not hold the thing.
            RefusedError: A motion is running.
        """
        if not self._held and name is None:
            return
        if name is not None:
            parse_name(_NAME, name)
        with self._changing():
            if name is not None and name not in self._held:
                raise UnknownNameError("held thing", name, self._held)
            T, things, held = self._tip_pose(), dict(self._things), dict(self._held)
            for each in [*held] if name is None else [name]:
                things[each] = held.pop(each).moved(T)
            self._change(things, held)

    def close(self) -> None:
        """Store this arm's position in the scenes of other arms before its port is closed."""
        for scene in self._others:
            scene._others[self].close()

    def _find_arm(self, name: str) -> Scene | None:
        return next((scene for scene, each in self._others.items() if each.name == name), None)

    def _change_others(self, others: dict[Scene, OtherArm]) -> None:
        self._others = others
        self._change(self._things, self._held)
        self._context.surroundings.set_others(tuple(others.values()))

    @contextmanager
    def _changing_both(self, other: Scene) -> Generator[None]:
        """Keep both arms and scenes unchanged in the ``with`` block; lock in a fixed order."""
        first, second = sorted((self, other), key=id)
        with _others_lock, first._changing(_WAIT_S), second._changing(_WAIT_S):
            yield

    def _check_new(self, name: str) -> None:
        taken = {*self.names, *self._held, "the table", *self._context.chain.frames}
        if parse_name(_NAME, name) in taken:
            raise BadValueError(_NAME, shown(name), "an unused name")

    def _tip_pose(self) -> Matrix:
        return self._context.planner.tip_pose(self._context.servos.measure_positions())

    @contextmanager
    def _changing(self, wait_s: float = -1.0) -> Generator[None]:
        """Keep the arm at rest and its scene unchanged; ``wait_s`` < 0 waits without limit."""
        lock, check_idle = self._runner.lock, self._context.servos.torque.check_idle
        if not lock.acquire(timeout=wait_s):  # another thread moves it
            raise RefusedError(
                f"{self._context.model.name} is moving, or its state is being read.",
                "Wait until it is at rest, or stop it.",
            )
        try:
            check_idle()
            with self._things_lock:
                yield
        finally:
            lock.release()

    @contextmanager
    def _changing_things(self) -> Generator[None]:
        """Prevent other changes in the ``with`` block; a running motion then checks its path."""
        locked = False
        while not (self._runner.watches_scene or locked):
            locked = self._runner.lock.acquire(timeout=_POLL_S)
        try:
            if locked:
                self._context.servos.torque.check_idle()
            with self._things_lock:
                yield
        finally:
            if locked:
                self._runner.lock.release()

    def _change(self, things: dict[str, Obstacle], held: dict[str, KeepOutShape]) -> None:
        model = self._context.model
        if self._context.collision is None:
            raise RefusedError(
                "This arm was opened without collision checks.", "A scene needs collision checks."
            )
        if self._body is None or held is not self._held:
            body = collision_body_with_gripper(model)
            for name, thing in held.items():
                body = body.with_attached(name, self._context.chain.tip, thing.capsules(name))
            self._body = body, arm_sag(model, body, list(held.values()))
        body, sag = self._body
        self._context.surroundings.place(body, list(things.values()), sag)
        self._things, self._held = things, held


def _pose_of_base(at_m: ArrayLike, rpy_deg: ArrayLike) -> Matrix:
    """Return the pose (4, 4) of another arm's base frame."""
    at = bounded_vector(at_m, 3, FURTHEST_BASE_M, "at_m", "a place on the same table, in metres")
    if np.linalg.norm(at) < NEAREST_BASE_M:
        raise BadValueError(
            "The place of the other arm", at.tolist(), "a place away from this arm's base"
        )
    return make_pose(at, rotation_rpy(*np.radians(finite_vector(rpy_deg, 3, "rpy_deg")).tolist()))


def _inverse(T: Matrix) -> Matrix:
    return make_pose(-T[:3, :3].T @ T[:3, 3], T[:3, :3].T)
