"""Another arm in reach of this one, and the present positions of its links."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

from ikservo.arm.motion_runner import MotionRunner
from ikservo.errors import IkservoError, RefusedError
from ikservo.hardware.port_names import is_simulated
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.model.catalogue import catalogue_name
from ikservo.model.scene_file import KeepOutShape, PlacedArm, capsule_shape, turned_deg
from ikservo.planning.context import ArmContext
from ikservo.planning.surroundings import Turn, other_moves

# Margin for backlash and bent links, which sensors do not show, and for drift during a motion.
_ROOM_M = 0.02
_ANSWER_S = 1.0  # reading an arm takes milliseconds, as do other uses of its lock


@dataclass(slots=True, eq=False)
class OtherArm:
    """Another arm near this one.

    Attributes:
        name: The name, for messages.
        context: The servos, model, calibration and checks of the other arm.
        runner: The runner of the other arm's motions.
        T_base_other: The pose (4, 4) of the other arm's base frame in this arm's base frame.
        turn: Lock that lets only one of the two arms move at a time.
        left: The result of ``things`` at the time when the other arm was closed; None while that
            arm is open, or if nothing could be measured.
    """

    name: str
    context: ArmContext
    runner: MotionRunner
    T_base_other: Matrix
    turn: Turn
    left: list[KeepOutShape] | None = None

    def close(self) -> None:
        """Store the arm's position, because nothing can be measured once the arm is closed."""
        with suppress(IkservoError), self.runner.lock:
            self.left = self.links_at(self.context.servos.measure_positions())

    def things(self, arm: object) -> list[KeepOutShape]:
        """Measure the other arm's links and held things; return capsules in this arm's base frame.

        A closed arm is assumed to stay where it was when it was closed.

        Raises:
            RefusedError: The other arm is moving, or its position cannot be measured.
        """
        if self.turn.is_of_other(arm):
            raise other_moves(self.name)
        return self.links_at(self._measure()) if self.left is None else self.left

    @property
    def placed(self) -> PlacedArm:
        """The placement of the other arm, by the keys of a scene file."""
        (x, y, z), R = self.T_base_other[:3, 3].tolist(), self.T_base_other[:3, :3]
        path, port = self.context.model.path, self.context.port.name
        arm = catalogue_name(path) or str(path.absolute())
        return PlacedArm(
            self.name,
            (x, y, z),
            turned_deg(R),
            "" if arm == self.name else arm,
            "" if is_simulated(port) else port,
        )

    def links_at(self, joints: Vector) -> list[KeepOutShape]:
        """Return the links at joints (n,), in the form that ``things`` returns.

        Raises:
            RefusedError: The arm was opened without collision checks.
        """
        checker = self.context.collision
        if checker is None:
            raise RefusedError(
                f"{self.name} was opened without collision checks.",
                "Open both arms with collision checks.",
            )
        capsules = checker.capsules_at(self.context.index.body_joints(joints))
        return [
            capsule_shape(f"{self.name}'s {each.link}", each, _ROOM_M).moved(self.T_base_other)
            for each in capsules
        ]

    def _measure(self) -> Vector:
        try:
            self.runner.check_open()
            self.context.require_zeros()
            if not self.runner.lock.acquire(timeout=_ANSWER_S):
                raise other_moves(self.name)
            try:
                return self.context.servos.measure_positions()
            finally:
                self.runner.lock.release()
        except RefusedError:
            raise
        except IkservoError as error:
            raise RefusedError(
                f"The position of {self.name}, which is in reach, is unknown: {error.message}",
                "Open it again and add it to the scene, or remove it from the scene.",
            ) from error
