"""The thing to pick up or put down: a click chooses it, and another thread searches for it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from ikservo.app import Panel
from ikservo.app_discovery import offered_part
from ikservo.apps.page.dragging.goal_planning import PlanRequest, SeveralMotions
from ikservo.apps.page.messages import page_messages as msg
from ikservo.apps.page.panels.camera_view import CameraView
from ikservo.apps.page.picking.lens_camera import LensCamera
from ikservo.apps.page.running.arm_thread import ArmThread
from ikservo.errors import format_point
from ikservo.kinematics.arrays import Vector
from ikservo.model.scene_file import KeepOutShape

HEADING = "What to pick up"


@dataclass(slots=True, eq=False)
class _GraspChoice:
    """The thing or place that the user chose; withdrawn once circumstances differ from ``before``.

    ``motion`` picks or places; it is None until ``look`` has found exactly one block. ``key``
    takes the place of the goal in plan requests, only to distinguish this choice from others.
    """

    before: object
    text: str
    look: Callable[[], Sequence[KeepOutShape]] | None = None
    motion: Any = None
    blocks: Sequence[KeepOutShape] = ()
    key: Vector = field(default_factory=lambda: np.zeros(0))


class GraspOffer:
    """The pick or place that was chosen last; ``GoalPlanner`` plans it in a separate thread.

    Args:
        arm_thread: Owns the arm.
    """

    def __init__(self, arm_thread: ArmThread) -> None:
        self._thread, self._arm = arm_thread, arm_thread.arm
        self._pick_box: Any = offered_part("pick box")
        self._place: Any = offered_part("put down")
        self._choice: _GraspChoice | None = None

    def choose(
        self,
        message: msg.Grasp | msg.RunPanelMotion,
        view: CameraView,
        camera: LensCamera,
        before: object,
    ) -> None:
        """Choose the block or the place at a pixel, or a block of the list, or list all blocks.

        Raises:
            InputError: The pixel is not in the picture, the picture is not usable, the list is out
                of date, or the arm has no gripper.
        """
        if self._arm.model.gripper is None or self._pick_box is None:
            raise msg.BadMessageError("This arm cannot pick up anything.", "Nothing moved.")
        view.require_usable()
        blocks = () if self._choice is None else self._choice.blocks
        grip: Any = self._arm.grip
        is_held = grip.is_held_at(self._arm.context, self._thread.snapshot.measured)
        if isinstance(message, msg.RunPanelMotion):
            if is_held:
                raise msg.BadMessageError("The gripper holds something.", "Put it down first.")
            same = [block for block in blocks if _describe(block) == message.button]
            if not same:
                raise msg.BadMessageError("That list is out of date.", "Look for blocks again.")
            text, motion = f"Pick up {message.button}.", self._pick_box(same[0])
            self._choice = _GraspChoice(before, text, motion=motion, blocks=blocks)
        elif is_held and message.at is None:
            self._choice = _GraspChoice(before, "Click where to put it down.")
        elif is_held and message.at is not None:
            x, y, z = view.surface(0.0).point_at(camera, np.array(message.at)).tolist()
            text, motion = format_point((x, y, z)), self._place((x, y, z + grip.height_m / 2.0))
            self._choice = _GraspChoice(before, f"Put it down at {text}.", motion=motion)
        else:
            look = view.block_finder(camera, message.at)
            self._choice = _GraspChoice(before, "Looking for blocks.", look)

    def drop(self) -> None:
        """Withdraw the choice."""
        self._choice = None

    def request(self, now: object) -> PlanRequest | None:
        """Return the plan request for the choice; withdraw the choice if ``now`` has changed."""
        choice, thread = self._choice, self._thread
        if choice is not None and choice.before != now:
            choice = self._choice = None
        if choice is None or not (choice.look or choice.motion):
            return None
        start, speed = thread.snapshot.start, thread.command.speed
        return PlanRequest(self._arm, choice.key, start, speed, plan=partial(self._plan, choice))

    def panels(self) -> dict[str, Panel]:
        """Return the panel that describes the choice, with a button for each block."""
        if self._choice is None:
            return {}
        buttons = dict.fromkeys(map(_describe, self._choice.blocks))
        return {HEADING: Panel([("choice", self._choice.text)], buttons)}

    def _plan(self, choice: _GraspChoice, request: PlanRequest) -> SeveralMotions | None:
        """Find the chosen thing, and plan its motions; None if the user has to choose a block."""
        if choice.look is not None:
            choice.blocks = choice.look()
            choice.text = f"Blocks found: {len(choice.blocks)}."
            if len(choice.blocks) == 1:
                choice.motion = self._pick_box(choice.blocks[0])
                choice.text = f"Pick up {_describe(choice.blocks[0])}."
            choice.look = None
        if choice.motion is None:
            return None
        motion = replace(choice.motion, speed=request.allowed_speed)
        steps, whole = motion.plan(self._arm.context, request.start, self._arm.grip)
        return whole, partial(motion.run, steps=steps)


def _describe(block: KeepOutShape) -> str:
    """Describe name, size and place of a block in at most 64 characters."""
    size = " x ".join(f"{2000.0 * half:.0f}" for half in block.half_size_m.tolist())
    return f"{block.name}, {size} mm, at ({block.row[9]:.3f}, {block.row[10]:.3f}) m"
