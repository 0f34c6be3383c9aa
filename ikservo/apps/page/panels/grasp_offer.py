"""A pick or a place that a click has chosen: planned in the background, shown, and offered."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor

from ikservo.apps.grasping.pick_and_place import Grip, Pick, Place, pick_box
from ikservo.apps.page.dragging.goal_planning import (
    PlannedPath,
    PlanRequest,
    refusal_of,
    show_plan,
)
from ikservo.apps.page.panels.camera_view import CameraView
from ikservo.apps.page.picking.lens_camera import LensCamera
from ikservo.apps.page.running.arm_thread import ArmThread
from ikservo.errors import IkservoError
from ikservo.kinematics.arrays import Vector


class GraspOffer:
    """The pick or place that was chosen last (``motion``); another goal withdraws it."""

    def __init__(self) -> None:
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="ikservo grasp")
        self._planning: Future[PlannedPath] | None = None
        self._is_shown = False
        self.motion: Pick | Place | None = None

    def choose(self, thread: ArmThread, view: CameraView, camera: LensCamera, px: Vector) -> None:
        """Plan to pick up the block at a pixel (2,), or to put down there what the gripper holds.

        Raises:
            InputError: There is no block, or no table, or the picture is not usable.
        """
        arm, start, speed = thread.arm, thread.snapshot.start, thread.command.speed
        grip: Grip = arm.grip
        if grip.T_thing_tip is None:
            motion = pick_box(view.block_at(*camera.picture_px(px)), speed=speed)
        else:
            x, y, z = view.surface(0.0).point_at(camera, px).tolist()
            motion = Place((x, y, z + grip.height_m / 2.0), speed=speed)

        def plan() -> PlannedPath:
            try:
                whole = motion.plan(arm.context, start, grip)[1]
            except IkservoError as error:
                refusal = refusal_of(start, error)
                return PlannedPath(PlanRequest(arm, start, start, speed), refusal=refusal)
            return show_plan(arm, PlanRequest(arm, whole.goal, start, speed), whole)

        self.motion, self._is_shown = motion, False
        self._planning = self._worker.submit(plan)

    def path_for(self, goal: Vector | None) -> PlannedPath | None:
        """Return the planned path; None if there is none, or the page shows another goal (n,)."""
        if self._planning is None or not self._planning.done():
            return None
        path = self._planning.result()
        if goal is not path.request.goal and (goal is not None or self._is_shown):
            self.motion = self._planning = None
            return None
        self._is_shown = True
        return path
