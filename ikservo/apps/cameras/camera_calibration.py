"""Calibration by camera: the arm shows the board on its gripper in postures that it chooses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import ClassVar

import numpy as np

from ikservo.apps.cameras.board import Board
from ikservo.apps.cameras.board_detection import (
    SAME_PICTURE,
    BoardView,
    Intrinsics,
    Picture,
    PictureSource,
    board_sample,
    find_board,
    guess_intrinsics,
)
from ikservo.apps.cameras.camera_and_arm_fit import (
    BoardSample,
    CameraEstimate,
    CameraFit,
    Extent,
    estimate_camera,
    fit_camera,
)
from ikservo.apps.cameras.camera_file import SIMULATED, CameraFile, camera_names, save_camera
from ikservo.apps.cameras.picture_folder import PictureFolder
from ikservo.apps.cameras.pose_choice import choose_postures, is_visible
from ikservo.arm.arm import Arm
from ikservo.calibration import JointMap
from ikservo.calibration.calibration_file import load_calibration, save_calibration
from ikservo.calibration.records import CalibratedCamera, Calibration, SeenBoard, shift_zeros
from ikservo.errors import CalibrationError, PictureError, RefusedError
from ikservo.files.public_source import public_source
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.bending_and_backlash import Bending
from ikservo.kinematics.chain import Chain
from ikservo.kinematics.joints import JointType
from ikservo.kinematics.se3 import log_so3
from ikservo.maintenance.dialogue import Dialogue, Notice, Progress
from ikservo.model import Model
from ikservo.planning.calibrated_arm import ZeroSource, known_bending, own_chain
from ikservo.planning.reports import ArmState

HAND_EXTENTS = (Extent.CAMERA, Extent.ZEROS)
"""The sets of parameters that a calibration by hand can estimate."""

PRINTED_COMPLIANCE = 0.05
"""Compliance of each joint of a printed arm, rad per N m; 0.05 to 0.1 were measured."""

LEAST_SHARE = 0.5
"""Smallest fraction of the requested pictures that suffices for an estimate."""

ESTIMATING = "Estimating the camera and the arm from the pictures, which takes a few seconds"

_SHOWING = "Showing the board to the camera"
_FIRST_STEP_RAD = math.radians(9.0)  # step of each joint while the pose of the camera is unknown
_REACH_RAD = math.radians(75.0)  # largest distance of a joint from the first posture
_CANDIDATES, _AT_ONCE, _MAX_MISSED = 1500, 4, 8
_SETTLE_S = 0.3  # wait after a motion, because a swinging board is blurred
_TIP_M = 0.001  # a zero is uncertain if it may move the tip further than this
_EXPOSURE_TRIES, _STEADY_GREY = 5, 4.0  # attempts, and allowed change of the mean grey, of 255
_LENS_STEPS, _SAME_LENS = 6, 1e-3  # iterations, and change of the lens that ends them
_CARRIED = (0.0, 0.25, 0.5, 0.75, 1.0)  # fractions of its weight that a hand-held arm may carry


@dataclass(frozen=True, slots=True, eq=False)
class CameraResult:
    """The result of a calibration from pictures.

    Attributes:
        estimate: The estimate of camera, board and arm.
        intrinsics: The intrinsics of the camera.
        board: The board on the gripper.
        pictures: Number of pictures in which the board was seen.
        missed: Number of pictures in which the board was not seen.
        duration_s: Time from the first picture to the last, by the arm's clock.
        carried: The fraction of its weight that the arm carried itself while the user held it; None
            if the user did not hold the arm, or if the compliance of its links is unknown.
        sag_m: Root mean square sag of the tip if the arm carried itself in these postures with
            ``PRINTED_COMPLIANCE``; None if the compliance is known.
    """

    estimate: CameraEstimate
    intrinsics: Intrinsics
    board: Board
    pictures: int
    missed: int
    duration_s: float
    carried: float | None = None
    sag_m: float | None = None

    @property
    def tip_shows(self) -> str | None:
        """Name of the last joint if its zero leaves the tip uncertain; otherwise None."""
        chain = self.estimate.fit.bending.dynamics.chain
        swing_m = np.linalg.norm(chain.jacobian(np.zeros(chain.dof))[:3, -1])  # per joint rad
        is_open = self.estimate.zero_deviations[-1] * swing_m > _TIP_M
        return chain.names[-1] if is_open and chain.kinds[-1] is JointType.REVOLUTE else None


@dataclass(frozen=True, slots=True)
class ArmBefore:
    """An arm before the pictures were taken; a simulated arm has no calibration."""

    model: Model
    calibration: Calibration | None

    @classmethod
    def of(cls, arm: Arm) -> ArmBefore:
        """Return the model and the calibration of an open arm.

        Raises:
            CalibrationError: The arm has no calibration to correct.
            FileFormatError: The calibration is damaged.
        """
        name = arm.model.name
        if arm.zeros is ZeroSource.SIMULATED:
            return cls(arm.model, None)
        calibration = load_calibration(name, arm.context.serial_number)
        if calibration is None:
            hint = f"Calibrate it first: ikservo calibrate {name}"
            raise CalibrationError(f"{name} has no calibration to correct.", hint)
        return cls(arm.model, calibration)

    def extents(self, name: str, *, by_hand: bool) -> Sequence[Extent]:
        """Return the parameters to estimate: only the camera's pose if the arm has other cameras.

        The other cameras were calibrated with the arm's present zeros and compliances. The hand
        carries the arm's weight, so a calibration by hand does not show how links bend.
        """
        if self.calibration is None:
            names = camera_names(self.model.name, SIMULATED)
        else:
            names = list(self.calibration.cameras_by_name)
        if set(names) - {name}:
            return (Extent.CAMERA,)
        return HAND_EXTENTS if by_hand else tuple(Extent)

    @property
    def bending(self) -> Bending:
        """The sag model of the arm, with its calibrated links and base."""
        calibration, chain = self.calibration, self.model.chain
        if calibration is not None:
            chain = own_chain(self.model, calibration)
        return known_bending(self.model, chain.rigid, calibration)


class BoardPictures:
    """Views of a board on the gripper, with the measured joint positions, kept in a folder."""

    def __init__(self, arm: ArmBefore, board: Board, folder: PictureFolder | None = None) -> None:
        self.board, self.views, self.joints = board, list[BoardView](), list[Vector]()
        self._known, self._folder = arm.bending, folder

    def __len__(self) -> int:
        """Count the pictures."""
        return len(self.views)

    def add(self, picture: Picture, view: BoardView, q: Vector) -> None:
        """Add a view of the board from a picture taken with the chain's joints at q (dof,).

        Raises:
            PictureError: The picture differs in size from the first picture.
            FileWriteError: The picture cannot be kept in the folder.
        """
        if self.views and view.size != self.views[0].size:
            now, first = ("{} x {}".format(*each.size) for each in (view, self.views[0]))
            hint = "Restore the camera's resolution, or start again."
            raise PictureError(f"The picture has {now} pixels, the first one had {first}.", hint)
        if self._folder is not None:
            self._folder.add(picture, q)
        self.views.append(view)
        self.joints.append(q)

    def fit(self) -> tuple[CameraFit, Intrinsics]:
        """Fit camera, lens and arm; iterate, because the poses depend nonlinearly on the lens.

        Raises:
            CalibrationError: The pictures do not suffice.
        """
        intrinsics = guess_intrinsics(self.board, self.views)
        fit = fit_camera(self._known, self._samples(intrinsics), Extent.ARM)
        for _ in range(_LENS_STEPS):
            intrinsics = Intrinsics.of_numbers(fit.lens, intrinsics.size)
            before, samples = fit.lens, self._samples(intrinsics)
            fit = fit_camera(self._known, samples, Extent.ARM)
            if np.abs(fit.lens - before).max() < _SAME_LENS:
                break
        return fit, intrinsics

    def result(
        self,
        missed: int,
        duration_s: float,
        extents: Sequence[Extent] = tuple(Extent),
        *,
        by_hand: bool = False,
    ) -> CameraResult:
        """Estimate camera and arm; see ``CameraResult``.

        ``missed`` pictures do not show the board. If the user held the arm (``by_hand``), several
        fractions of its weight are tried; the best predictor of left-out pictures is used.

        Raises:
            CalibrationError: The pictures do not suffice, or contradict each other.
        """
        intrinsics, known = self.fit()[1], self._known
        samples = self._samples(intrinsics)
        is_tried = by_hand and bool(known.compliance.any() or known.half_play.any())
        estimates = {
            share: estimate_camera(
                replace(
                    known, compliance=share * known.compliance, half_play=share * known.half_play
                ),
                samples,
                extents,
            )
            for share in (_CARRIED if is_tried else (1.0,))
        }
        share, best = min(estimates.items(), key=lambda each: each[1].after_m)
        sag_m = None
        if by_hand and not is_tried:
            chain, q = known.dynamics.chain, np.array(self.joints)
            turns = np.array([float(kind is JointType.REVOLUTE) for kind in chain.kinds])
            bent = replace(known, compliance=PRINTED_COMPLIANCE * turns)
            sags: Matrix = chain.forward(bent.link_joints(q))[:, :3, 3] - chain.forward(q)[:, :3, 3]
            sag_m = math.sqrt(float(np.sum(sags**2)) / len(q))
        return CameraResult(
            best, intrinsics, self.board, len(self), missed, duration_s,
            carried=share if is_tried else None, sag_m=sag_m,
        )  # fmt: skip

    def _samples(self, intrinsics: Intrinsics) -> list[BoardSample]:
        samples: list[BoardSample] = []
        for number, (q, view) in enumerate(zip(self.joints, self.views, strict=True), start=1):
            with suppress(CalibrationError):
                samples.append(board_sample(self.board, view, intrinsics, q, f"picture {number}"))
        return samples


class PictureCalibration:
    """Calibration of an arm and a camera from pictures of the board on the gripper.

    Args:
        arm: The arm.
        camera: The camera, which must not move.
        board: The board on the gripper.
        count: The number of pictures to use.
        extents: The parameters that may be estimated; None: all that this calibration can estimate.
        folder: The folder in which to keep the pictures; None to keep none.
    """

    _all_extents: ClassVar[Sequence[Extent]] = tuple(Extent)

    def __init__(
        self,
        arm: Arm,
        camera: PictureSource,
        board: Board,
        count: int,
        extents: Sequence[Extent] | None = None,
        folder: PictureFolder | None = None,
    ) -> None:
        self._extents = extents or self._all_extents
        self._arm, self._camera = arm, camera
        self._pictures = BoardPictures(ArmBefore.of(arm), board, folder)
        self._count = count
        self._missed: int = 0
        self._began_s = arm.clock.now_s()
        self._last: Picture | None = None

    def _require_new(self, picture: Picture) -> None:
        """Refuse a picture that is the same as the last one."""
        if self._last is not None and np.array_equal(picture, self._last):
            raise PictureError(*SAME_PICTURE)
        self._last = picture


class CameraCalibration(PictureCalibration):
    """Calibration by an arm that moves the board.

    At the start, the board is in front of the camera, near the middle of the picture.
    """

    def run(self) -> Dialogue[CameraResult]:
        """Take the pictures, compute the estimate, and move the arm back to its start if possible.

        Raises:
            CalibrationError: The board is not seen, or the pictures do not suffice; the arm holds.
            RefusedError: The arm may not move, or was stopped.
            StoppedError: The arm was stopped in a motion; it holds.
        """
        self._began_s = self._arm.clock.now_s()
        yield Progress(_SHOWING)
        self._arm.enable()  # an arm that is held or lies on a table bends differently
        self._keep(self._take())  # nothing moves until the board has been seen
        home = self._pictures.joints[0]
        # Postures around the first one, with each joint moved once to either side.
        signs = np.diag(np.resize([1.0, -1.0], len(home)))
        steps = _FIRST_STEP_RAD * np.vstack([signs, -0.7 * signs])
        for step in self._arm.chain.clip(home + steps):
            if len(self._pictures) < self._count:
                yield from self._visit(step)
        while len(self._pictures) < self._count and (yield from self._visit_best(home)):
            pass
        if len(self._pictures) < LEAST_SHARE * self._count:
            hint = "Put the camera further away, or the board nearer to the middle of its picture."
            raise PictureError(f"The board was seen in only {len(self._pictures)} postures.", hint)
        with suppress(RefusedError):
            self._move(home)
        yield Notice(f"{ESTIMATING}.")
        yield Progress(ESTIMATING)
        duration_s = self._arm.clock.now_s() - self._began_s
        return self._pictures.result(self._missed, duration_s, self._extents)

    def _visit_best(self, home: Vector) -> Dialogue[bool]:
        """Visit the most informative postures; return whether the board was seen."""
        fit, intrinsics = self._pictures.fit()
        chain = self._arm.chain
        chance = np.random.default_rng(len(self._pictures) + self._missed)
        low = np.maximum(chain.lower_rad, home - _REACH_RAD)
        high = np.minimum(chain.upper_rad, home + _REACH_RAD)
        tried = chance.uniform(low, high, (_CANDIDATES, chain.dof))
        seen = tried[is_visible(self._pictures.board, intrinsics, fit.board_poses(tried))]
        visited, chosen = 0, list[int]()
        if len(seen):
            done, board = np.array(self._pictures.joints), self._pictures.board
            chosen = choose_postures(board, fit, intrinsics, seen, done, 3 * _AT_ONCE)
        for q in seen[chosen]:
            visited += yield from self._visit(q)
            if visited == _AT_ONCE or len(self._pictures) == self._count:
                break
        return visited > 0

    def _visit(self, q: Vector) -> Dialogue[bool]:
        """Move to a posture; return whether it could be reached and the board was seen there."""
        try:
            self._move(q)
        except RefusedError:
            self._arm.context.servos.check_stop()
            return False  # an obstacle is in the way
        picture = self._take()  # nothing moves without a fresh picture
        try:
            self._keep(picture)
        except CalibrationError as error:
            self._missed += 1
            if self._missed > _MAX_MISSED:
                raise
            yield Notice(f"not used: {error.message}")
            return False
        taken, since_s = len(self._pictures), self._arm.clock.now_s() - self._began_s
        what = f"picture {taken} of {self._count}"
        yield Notice(str(Progress(what, taken, self._count, since_s)))
        yield Progress(_SHOWING, taken, self._count, since_s)
        return True

    def _move(self, q: Vector) -> None:
        goals = dict(zip(self._arm.chain.names, q.tolist(), strict=True))
        self._arm.move_joints(goals, speed="normal")

    def _take(self) -> Picture:
        """Take a picture of the resting arm."""
        clock = self._arm.clock
        clock.sleep_until(clock.now_s() + _SETTLE_S)
        picture = self._camera.take()
        for _ in range(_EXPOSURE_TRIES):
            self._arm.context.servos.check_stop()  # a picture may take ten seconds
            before, picture = picture, self._camera.take()
            if abs(float(picture.mean()) - float(before.mean())) < _STEADY_GREY:
                break
        else:
            hint = "Switch the camera's automatic exposure off."
            raise PictureError("The brightness of the picture keeps changing.", hint)
        self._require_new(picture)
        return picture

    def _keep(self, picture: Picture) -> None:
        """Store the view of the board in a picture, with the measured joint positions."""
        view = find_board(self._pictures.board, picture)
        q = measured_joints(self._arm.chain, self._arm.where())
        self._pictures.add(picture, view, q)


def measured_joints(chain: Chain, state: ArmState) -> Vector:
    """Return the measured joints (dof,) of a chain, rad or m."""
    return np.array([state[name].position_rad for name in chain.names])


def chain_maps(model: Model, calibration: Calibration) -> list[JointMap]:
    """Return the maps of the chain's joints with the zeros and signs from a calibration."""
    maps = [model.joint(name).joint_map for name in model.chain.names]
    found = [(calibration.joint(nominal.joint), nominal) for nominal in maps]
    return [joint.joint_map(nominal) if joint else nominal for joint, nominal in found]


def save_camera_result(
    arm: ArmBefore, source: str, result: CameraResult, written: datetime, name: str = ""
) -> Path:
    """Save the estimated arm and camera in the calibration.

    A simulated arm has no calibration, so only its camera is saved, under ``name``.

    Raises:
        FileWriteError: The disk is full or not writable; the old file is unchanged.
    """
    model, camera = arm.model, _calibrated_camera(source, result, written)
    if arm.calibration is None:
        known = CameraFile(calibrated=written, camera=camera)
        return save_camera(model.name, SIMULATED, known, name)
    calibration = arm.calibration
    fit, names = result.estimate.fit, model.chain.names
    joints = calibration.joints
    if fit.extent.zeros:
        joints = shift_zeros(joints, chain_maps(model, calibration), fit.zeros)
    if fit.extent.bending:
        compliance = dict(zip(names, fit.bending.compliance.tolist(), strict=True))
        half_play = dict(zip(names, fit.bending.half_play.tolist(), strict=True))
        joints = tuple(
            joint.model_copy(
                update={
                    "compliance": round(compliance[joint.name], 5),
                    "play_deg": round(math.degrees(2.0 * half_play[joint.name]), 4),
                }
            )
            if joint.name in compliance
            else joint
            for joint in joints
        )
    changed = calibration.model_copy(update={"joints": joints, "written": written})
    changed = changed.with_cameras(calibration.cameras_by_name | {name: camera})
    return save_calibration(changed)


def _calibrated_camera(source: str, result: CameraResult, written: datetime) -> CalibratedCamera:
    fit, lens = result.estimate.fit, result.intrinsics
    fx, cx, fy, cy = lens.matrix[0, 0], lens.matrix[0, 2], lens.matrix[1, 1], lens.matrix[1, 2]
    T, board = np.linalg.inv(fit.T_camera_base), result.board.name
    return CalibratedCamera(
        source=public_source(source),
        seen=written,
        pictures=len(fit.kept),
        left_out=int(np.count_nonzero(~fit.kept)),
        before_mm=1000.0 * result.estimate.before_m,
        after_mm=1000.0 * result.estimate.after_m,
        size_px=lens.size,
        lens_px=(float(fx), float(fy), float(cx), float(cy)),
        distortion=tuple(lens.distortion.tolist()),
        at_mm=tuple((1000.0 * T[:3, 3]).tolist()),
        turned_deg=tuple(np.degrees(log_so3(T[:3, :3])).tolist()),
        board=seen_board(board, fit.T_tip_board, 1.0 + fit.scale),
        tip_shows=result.tip_shows,
    )


def seen_board(name: str, T: Matrix, scale: float) -> SeenBoard:
    """Return the data to store for a board: name, pose (4, 4), and size relative to the name."""
    return SeenBoard(
        name=name,
        scale=scale,
        at_mm=tuple((1000.0 * T[:3, 3]).tolist()),
        turned_deg=tuple(np.degrees(log_so3(T[:3, :3])).tolist()),
    )
