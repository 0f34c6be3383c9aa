"""A motion that is shown before it runs: a pick, a put-down, or a step of the program."""

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
from ikservo.apps.page.picking.projection import Camera
from ikservo.apps.page.running.arm_thread import ArmThread
from ikservo.apps.teaching.replaying import Replay
from ikservo.errors import format_point
from ikservo.kinematics.arrays import Vector
from ikservo.model.scene_file import KeepOutShape
from ikservo.planning.motions import SPEEDS, MotionValue
from ikservo.planning.preflight_planner import PlannedStart, PreflightPlanner

HEADING = "What to pick up"


@dataclass(slots=True, eq=False)
class _ChosenMotion:
    """The thing, place or step that the user chose; withdrawn once ``before`` is different.

    ``motion`` is None until ``look`` has found exactly one block. ``key`` takes the place of the
    goal in plan requests, only to distinguish this choice from others.
    """

    before: object
    text: str
    look: Callable[[], Sequence[KeepOutShape]] | None = None
    motion: Any = None
    blocks: Sequence[KeepOutShape] = ()
    key: Vector = field(default_factory=lambda: np.zeros(0))

    @property
    def is_step(self) -> bool:
        """Whether this is a step of the program, which needs no text: its row names it."""
        return not self.text


class MotionOffer:
    """The motion that was chosen last; ``GoalPlanner`` plans it in a separate thread.

    Args:
        arm_thread: Owns the arm.
    """

    def __init__(self, arm_thread: ArmThread) -> None:
        self._thread, self._arm = arm_thread, arm_thread.arm
        self._pick_box: Any = offered_part("pick box")
        self._place: Any = offered_part("put down")
        self._choice: _ChosenMotion | None = None

    def choose(
        self,
        message: msg.Grasp | msg.RunPanelMotion,
        view: CameraView,
        camera: Camera,
        before: object,
    ) -> None:
        """Choose the block or the place at a pixel, or a block of the list, or list all blocks.

        Raises:
            InputError: The pixel is not in the picture, the picture is not usable, the list is out
                of date, or the arm has no gripper.
        """
        if self._arm.model.gripper is None or self._pick_box is None:
            raise msg.BadMessageError("This arm cannot pick up anything.", "Nothing moved.")
        if isinstance(camera, LensCamera):
            view.require_usable()
        grip: Any = self._arm.grip
        is_held = grip.is_held_at(self._arm.context, self._thread.snapshot.measured)
        if isinstance(message, msg.RunPanelMotion):
            if is_held:
                raise msg.BadMessageError("The gripper holds something.", "Put it down first.")
            same = [block for block in self.blocks if _describe(block) == message.button]
            if not same:
                raise msg.BadMessageError("That list is out of date.", "Look for blocks again.")
            self._choose_block(same[0], before)
        elif is_held and message.at is None:
            self._choice = _ChosenMotion(before, "Click where to put it down.")
        elif is_held and message.at is not None:
            x, y, z = view.surface(0.0).point_at(camera, np.array(message.at)).tolist()
            text, motion = format_point((x, y, z)), self._place((x, y, z + grip.height_m / 2.0))
            self._choice = _ChosenMotion(before, f"Put it down at {text}.", motion=motion)
        elif message.at is None:
            self._choice = _ChosenMotion(before, "Looking for blocks.", view.block_finder())
        elif isinstance(camera, LensCamera):
            look = view.block_finder(camera.picture_px(np.array(message.at)))
            self._choice = _ChosenMotion(before, "Looking for blocks.", look)
        else:
            ray = camera.ray(np.array(message.at))
            along_m = {ray.distance_to_thing_m(block.row): block for block in self.blocks}
            if np.isfinite(nearest_m := min(along_m, default=np.inf)):
                self._choose_block(along_m[nearest_m], before)
            else:
                text = "No known block is there. Switch Pick up off and on to look for blocks."
                self._choice = _ChosenMotion(before, text, blocks=self.blocks)

    def _choose_block(self, block: KeepOutShape, before: object) -> None:
        text, motion = f"Pick up {_describe(block)}.", self._pick_box(block)
        self._choice = _ChosenMotion(before, text, motion=motion, blocks=self.blocks)

    def choose_step(self, motion: MotionValue[Any], before: object) -> None:
        """Choose the motion of a step of the program."""
        self._choice = _ChosenMotion(before, "", motion=motion)

    def drop_step(self) -> None:
        """Withdraw the choice if it is a step of the program."""
        if self._choice is not None and self._choice.is_step:
            self._choice = None

    @property
    def blocks(self) -> Sequence[KeepOutShape]:
        """The blocks of the list."""
        return () if self._choice is None else self._choice.blocks

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
        if self._choice is None or self._choice.is_step:
            return {}
        buttons = dict.fromkeys(map(_describe, self._choice.blocks))
        return {HEADING: Panel([("choice", self._choice.text)], buttons)}

    def _plan(self, choice: _ChosenMotion, request: PlanRequest) -> SeveralMotions | None:
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
        if choice.is_step:
            return self._plan_step(choice.motion, request)
        motion = replace(choice.motion, speed=request.allowed_speed)
        steps, whole = motion.plan(self._arm.context, request.start, self._arm.grip)
        return whole, partial(motion.run, steps=steps)

    def _plan_step(self, motion: MotionValue[Any], request: PlanRequest) -> SeveralMotions:
        """Plan a step at its speed, if the page allows it; what runs is what was planned."""
        context, start = self._arm.context, request.start
        speeds = getattr(motion, "speed", "slow"), request.allowed_speed
        motion = motion.with_speed(min(speeds, key=SPEEDS.index))
        planner = PreflightPlanner(context, PlannedStart(start), self._arm.poses)
        if isinstance(motion, Replay):
            replayed, whole = motion.plan(context, start, planner)
            return whole, partial(motion.run, loaded=replayed)
        plan = replace(planner.plan(motion), limp_arm=None)
        return plan, lambda arm, on_progress: arm.execute(plan, on_progress)


def _describe(block: KeepOutShape) -> str:
    """Describe name, size and place of a block in at most 64 characters."""
    size = " x ".join(f"{2000.0 * half:.0f}" for half in block.half_size_m.tolist())
    return f"{block.name}, {size} mm, at ({block.row[9]:.3f}, {block.row[10]:.3f}) m"
