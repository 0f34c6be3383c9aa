"""Calibration by camera and by hand: the user shows the board on the limp arm to the camera."""

from __future__ import annotations

import math

import numpy as np

from ikservo.apps.cameras.board_detection import BoardView, Picture, find_board
from ikservo.apps.cameras.camera_calibration import (
    ESTIMATING,
    HAND_EXTENTS,
    LEAST_SHARE,
    CameraResult,
    PictureCalibration,
    measured_joints,
)
from ikservo.control.stillness import StillnessDetector
from ikservo.errors import CalibrationError, PictureError
from ikservo.kinematics.arrays import Vector
from ikservo.maintenance.dialogue import Dialogue, Notice, Progress

# The arm moves by less than this while a hand holds it for a picture.
_HELD = StillnessDetector(window_s=0.3, tolerance=math.radians(0.3), least_readings=2)
_STILL_PX = 0.7  # the corners of a board at rest move by less than this between two pictures
_APART_RAD = math.radians(8.0)  # a joint must differ by this much from every earlier picture
_WAIT_S = 60.0  # time-out for the next picture
_PERIOD_S = 0.1


class HandCalibration(PictureCalibration):
    """Calibration that takes pictures of the board on an arm that the user moves by hand.

    A picture is used if arm and board are still, and if a joint differs by 8° from every earlier
    picture. The calibration ends when it has the requested number of pictures, or, once it has
    half of them, after a minute without another picture. The arm's torque is off; parameters from
    ``HAND_EXTENTS`` may be estimated.
    """

    _all_extents = HAND_EXTENTS
    _last_error = ""

    def run(self) -> Dialogue[CameraResult]:
        """Take pictures until there are enough, and estimate the camera and the zeros.

        Raises:
            CalibrationError: The arm is not limp, the camera gives no picture, the board is not
                seen for a minute, or the pictures do not suffice.
        """
        clock = self._arm.clock
        began_s = used_s = clock.now_s()
        while len(self._pictures) < self._count and clock.now_s() - used_s < _WAIT_S:
            if (yield from self._use_picture()):
                used_s = clock.now_s()
            clock.sleep_until(clock.now_s() + _PERIOD_S)
        if len(self._pictures) < LEAST_SHARE * self._count:
            raise PictureError(
                f"No new picture for {_WAIT_S:.0f} s; only {len(self._pictures)} of {self._count} "
                f"so far. {self._last_error}".rstrip(),
                "Show the board in different postures, and keep the arm still in each.",
            )
        yield Notice(f"{ESTIMATING}.")
        yield Progress(ESTIMATING)
        duration_s = used_s - began_s
        return self._pictures.result(self._missed, duration_s, self._extents, by_hand=True)

    def _use_picture(self) -> Dialogue[bool]:
        """Take one picture; return whether it was used."""
        q, clock = self._limp_joints(), self._arm.clock
        held = _HELD.add_joints(clock.now_s(), q.tolist())
        if any(np.abs(q - other).max() < _APART_RAD for other in self._pictures.joints):
            return False
        _, first = yield from self._look()
        if first is None:
            return False
        clock.sleep_until(clock.now_s() + _HELD.window_s)
        picture, second = yield from self._look()
        if second is None:
            return False
        held = held.add_joints(clock.now_s(), self._limp_joints().tolist())
        both, at_first, at_second = np.intersect1d(first.ids, second.ids, return_indices=True)
        moved_px = np.linalg.norm(first.pixels[at_first] - second.pixels[at_second], axis=1)
        is_still = len(both) > 0 and float(np.median(moved_px)) < _STILL_PX
        if held.has_moved() or not is_still:
            return False
        self._pictures.add(picture, second, q)
        self._last_error = ""
        yield Notice(
            f"picture {len(self._pictures)} of {self._count} taken: move the arm to another posture"
        )
        return True

    def _limp_joints(self) -> Vector:
        """Measure the chain's joints (dof,)."""
        state = self._arm.where()
        if state.torque.any():
            hint = "Close other programs that use the arm."
            raise CalibrationError("The arm is no longer limp: the torque of a servo is on.", hint)
        return measured_joints(self._arm.chain, state)

    def _look(self) -> Dialogue[tuple[Picture, BoardView | None]]:
        """Take a picture and find the board in it; report once why the board is not found."""
        picture = self._camera.take()
        self._require_new(picture)
        try:
            return picture, find_board(self._pictures.board, picture)
        except CalibrationError as error:
            self._missed += 1
            if error.message != self._last_error:
                self._last_error = error.message
                yield Notice(f"not used: {error.message}")
            return picture, None
