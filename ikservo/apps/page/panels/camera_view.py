"""The picture of a calibrated camera as a view of the arm, in which clicks can be targets."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from datetime import UTC, datetime
from functools import partial
from typing import cast

from ikservo.apps.cameras.arm_camera import (
    camera_key,
    camera_model,
    known_camera,
    moved_error,
    table_m,
)
from ikservo.apps.cameras.blocks import find_block_at, find_blocks
from ikservo.apps.cameras.board_detection import Picture, find_board, is_mirrored
from ikservo.apps.cameras.camera_check import BoardPlace, compare_place
from ikservo.apps.cameras.camera_file import CameraCheck, save_camera
from ikservo.apps.cameras.tip_click import TipZero, find_tip_zero
from ikservo.apps.page.dragging.snapshot import ArmSnapshot
from ikservo.apps.page.messages.page_messages import BadMessageError
from ikservo.apps.page.panels.video import VideoSource
from ikservo.apps.page.picking.lens_camera import LensCamera, PictureSurface, make_lens_camera
from ikservo.apps.page.picking.projection import Viewport
from ikservo.arm import Arm
from ikservo.clock import Clock
from ikservo.control.stillness import StillnessDetector
from ikservo.errors import CalibrationError, IkservoError
from ikservo.files.public_source import public_source
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.model.scene_file import KeepOutShape

_CHECK_PERIOD_S = 1.0  # period of checks while pictures arrive
# Time at rest, longer than the delay of a picture; encoder noise at rest is two ticks.
_REST_S = 0.5
_STANDS = StillnessDetector(_REST_S, tolerance=3.5e-3, least_readings=2)


class CameraView:
    """A calibrated camera whose pictures a page shows.

    Args:
        arm: The arm in front of the camera.
        video: The source of the pictures.
        clock: Determines when to check whether the camera has moved.
        name: The camera name; empty: the camera with the source of the pictures.

    Attributes:
        tip_shows: The joint whose zero a click on the tip would determine; None if there is none.
        tip_clicks: The number of clicks.

    Raises:
        CalibrationError: The arm has no calibrated camera, or a different one was calibrated.
        FileFormatError: A file about the camera is damaged.
    """

    def __init__(self, arm: Arm, video: VideoSource, clock: Clock, name: str = "") -> None:
        camera, self._known, self._name = known_camera(arm.context, name, video.source)
        calibrated = public_source(camera.source)
        if not name and calibrated != public_source(video.source):
            raise CalibrationError(
                f"{arm.model.name} was calibrated with camera {calibrated}, not this one."
            )
        self._arm, self._video, self._clock = arm, video, clock
        self._model, self.tip_shows = camera_model(camera), camera.tip_shows
        self.tip_clicks = len(camera.tip_clicks)
        check = self._known.check
        self._moved = check if check is not None and check.has_moved else None
        self._mirrored = ""
        self._place = None
        if camera.board is not None or self._known.board is not None:
            self._place = BoardPlace(camera, self._known)
        self._made: LensCamera | None = None
        self._stillness = _STANDS
        self._doubts, self._checked_s = 0, clock.now_s()
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="ikservo camera check")
        self._checking: Future[CameraCheck | str | None] | None = None

    def close(self) -> None:
        """Cancel the running check."""
        self._worker.shutdown(wait=False, cancel_futures=True)

    def camera(self, viewport: Viewport) -> LensCamera:
        """Return the camera of a drawing."""
        if self._made is None or self._made.viewport != viewport:
            self._made = make_lens_camera(self._model, viewport)
        return self._made

    def plane_m(self, height_m: float) -> float:
        """Return z, in the base frame, of the level plane at a height above the table."""
        return table_m(self._arm.model) + height_m

    def surface(self, height_m: float) -> PictureSurface:
        """Return the surface for targets of clicks, at a height above the table."""
        return PictureSurface(self._arm.scene.things, self.plane_m(height_m))

    def block_finder(
        self, px: tuple[float, float] | None = None
    ) -> Callable[[], list[KeepOutShape]]:
        """Return a search for the block at a pixel (2,) of the picture, or for all blocks.

        Raises:
            BadMessageError: The picture is not usable.
            BadValueError: The pixel is not in the picture.
        """
        self.require_usable()
        seen = self._model, cast("Picture", self._video.newest), self.plane_m(0.0)
        if px is None:
            return partial(find_blocks, *seen)
        self._model.ray(*px)
        return lambda: [find_block_at(*seen, *px)]

    @property
    def change(self) -> str:
        """Reason why the picture does not show this arm as calibrated; empty if it does."""
        if self._moved is not None:
            return moved_error(self._moved.moved_mm, self._moved.turned_deg).message
        if self._mirrored:
            return self._mirrored
        if self._video.before not in (None, self._arm.context.port.transport):
            return "The picture shows another simulated arm."
        picture, (width, height) = self._video.newest, self._model.lens.size
        if picture is not None and picture.shape[:2] != (height, width):
            seen = f"{picture.shape[1]} x {picture.shape[0]}"
            return f"The pictures have {seen} pixels, not {width} x {height} as calibrated."
        return ""

    @property
    def trouble(self) -> str:
        """Return the reason why clicks in the picture are not targets, or an empty text."""
        if self._video.is_fresh:
            return self.change
        return self.change or "The camera picture is too old. Is the camera connected?"

    def require_usable(self) -> None:
        """Refuse targets from a picture that is old, or of a camera that has moved.

        Raises:
            BadMessageError: The picture is old, or the camera has moved.
        """
        if self.trouble:
            raise BadMessageError(self.trouble, "Nothing moved. Choose a target in another view.")

    def find_tip_zero(self, camera: LensCamera, px: Vector, snapshot: ArmSnapshot) -> TipZero:
        """Find the zero that puts the tip at a click on a pixel (2,) of the drawing.

        Raises:
            BadMessageError: The picture is not usable, or the arm is not at rest.
            CalibrationError: The click determines no zero.
        """
        self.require_usable()
        is_old = self._clock.now_s() - snapshot.read_s > _REST_S
        if is_old or not self._rests(snapshot.measured):
            raise BadMessageError("The arm was not seen at rest yet.", "Click again in a moment.")
        written, pixel = datetime.now(UTC).replace(microsecond=0), camera.picture_px(px)
        return find_tip_zero(self._arm, [pixel], written, self._name, snapshot.measured)

    def watch(self, measured: Vector) -> None:
        """Check periodically, while pictures arrive, whether the camera has moved."""
        now_s, rests = self._clock.now_s(), self._rests(measured)
        if self._checking is not None:
            if self._checking.done():
                self._judge(self._checking.result())
                self._checking = None
            return
        place, picture = self._place, self._video.newest
        if place is None or picture is None or not self._video.is_fresh:
            return
        if (rests or place.on_table) and now_s - self._checked_s >= _CHECK_PERIOD_S:
            self._checked_s = now_s
            q = self._arm.joint_index.chain_joints(measured)
            T_base_tip = self._arm.chain.forward(q)
            self._checking = self._worker.submit(self._look, place, picture, T_base_tip)

    def _rests(self, measured: Vector) -> bool:
        """Check whether all joints (n,) have been still for longer than a picture takes."""
        self._stillness = self._stillness.add_joints(self._clock.now_s(), measured.tolist())
        return self._stillness.is_at_rest()

    def _look(
        self, place: BoardPlace, picture: Picture, T_base_tip: Matrix
    ) -> CameraCheck | str | None:
        """Evaluate the camera's place from a picture, or return why that is not possible."""
        try:
            view = find_board(place.board, picture)
            return compare_place(self._model, place, T_base_tip, view, datetime.now(UTC))
        except CalibrationError:
            return "The picture is mirrored." if is_mirrored(place.board, picture) else None

    def _judge(self, check: CameraCheck | str | None) -> None:
        """Accept a result that two consecutive pictures confirm, and save it for other programs."""
        if isinstance(check, str):
            self._mirrored = check
            return
        if check is not None:
            self._mirrored = ""
        if check is None or check.has_moved == (self._moved is not None):
            self._doubts = 0
            return
        self._doubts += 1
        if self._doubts < 2:
            return
        self._doubts, self._moved = 0, check if check.has_moved else None
        self._known = self._known.model_copy(update={"check": check})
        with suppress(IkservoError):  # if the disk is full, only this page knows
            key = camera_key(self._arm.context)
            save_camera(self._arm.model.name, key, self._known, self._name)
