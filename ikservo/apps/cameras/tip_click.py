"""Find the zero of the last joint from clicks on the tip in pictures of a calibrated camera.

Pictures of a board on the gripper cannot distinguish this zero from the angle at which the board
is mounted; pictures of the tip can. Each value of the zero puts the tip at another point of an arc
in the picture; the point nearest to the click is used. Clicks are stored with the camera, and their
mean is used, because click errors average out. The error of the camera does not average out.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ikservo.apps.cameras.arm_camera import known_camera
from ikservo.apps.cameras.camera_calibration import ArmBefore, chain_maps, seen_board
from ikservo.apps.cameras.camera_check import stored_pose
from ikservo.apps.cameras.camera_model import CameraModel
from ikservo.arm.arm import Arm
from ikservo.calibration.calibration_file import save_calibration
from ikservo.calibration.records import CalibratedCamera, Calibration, TipClick, shift_zeros
from ikservo.control.stillness import StillnessDetector, read_until_at_rest
from ikservo.errors import CalibrationError
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.chain import Chain
from ikservo.kinematics.joints import JointType
from ikservo.kinematics.rays import Ray

_MOST_RAD, _STEP_RAD = math.radians(10.0), math.radians(0.05)  # search range for a zero set by eye
_LEAST_PX = 1.0  # a degree must move the tip by at least this many pixels
_CLICK_PX = 1.5  # standard error of a careful click, per axis
_DOUBTFUL = 4.0  # a click this many standard errors from the mean of the others is left out
_ENOUGH, _KNOWN_MM = 3, 0.5  # clicks that suffice (one may be wrong), and the tip error then
_OFF_MM = 3.0  # distance of a good click from the arc, in addition to the camera's error
# Number of postures tried per joint, and their least distance from the present posture.
_POSTURES, _APART_RAD = 37, math.radians(20.0)
_EDGE_PX = 30.0  # margin of the picture in which no next click is proposed
# A click needs an arm at rest: in this time, its joints move by at most a tick of noise.
_STANDS = StillnessDetector(window_s=0.3, tolerance=math.radians(0.1), least_readings=2)
_SAME_TICK = 0.01


@dataclass(frozen=True, slots=True)
class TipZero:
    """The result of clicks on the tip.

    Attributes:
        joint: The last joint.
        shift_rad: The correction of the joint: its true angle minus its measured angle.
        off_m: The distance from the last click to the corrected tip, across the line of sight.
        px_per_deg: Motion of the tip in the picture per degree of the joint, pixels.
        others_deg: The deviation of each click from the mean, the latest clicks last.
        counts: Whether each click is used; a click too far from two or more others is ignored.
        are_apart: Whether there are only two clicks, and they differ by more than click errors.
        error_deg: The standard error of the zero.
        error_m: The standard error of the tip that remains.
        advice: Advice on where to click next; empty if another click is not useful.
        before: The calibration with which the zero was found.
        calibration: The same calibration with the new zero and the clicks.
    """

    joint: str
    shift_rad: float
    off_m: float
    px_per_deg: float
    others_deg: tuple[float, ...]
    counts: tuple[bool, ...]
    are_apart: bool
    error_deg: float
    error_m: float
    advice: str
    before: Calibration
    calibration: Calibration

    def __str__(self) -> str:
        count, clicks = sum(self.counts), len(self.counts)
        of = "1 click" if clicks == 1 else f"{count} of {clicks} clicks"
        said = [
            f"{self.joint} is {math.degrees(self.shift_rad):+.2f}° from its measured angle, "
            f"according to {of}; standard error {self.error_deg:.2f}°, {1000.0 * self.error_m:.1f}"
            f" mm at the tip. The corrected tip is {1000.0 * self.off_m:.1f} mm from the click."
        ]
        said += [
            f"Click {i} differs by {by:+.1f}°, more than its error, and is ignored."
            for i, (by, does) in enumerate(zip(self.others_deg, self.counts, strict=True), start=1)
            if not does
        ]
        if self.are_apart:
            said.append("The two remaining clicks differ by more than their error: click again.")
        elif 2 * count <= clicks:
            said.append(
                "Half of the clicks or more were ignored, and those may be the right ones: "
                "click again."
            )
        return " ".join(said)


def find_tip_zero(
    arm: Arm,
    pixels: Sequence[tuple[float, float]],
    written: datetime,
    name: str = "",
    joints: Vector | None = None,
) -> TipZero:
    """Find the zero of the last joint that puts the tip at the clicks, without saving it.

    Earlier clicks that the calibration stores, for any of its cameras, are also used.

    Args:
        arm: The arm in front of the camera, at rest.
        pixels: The pixels (u, v) of one or more clicks on the tip.
        written: The time stamp of the calibration with the new zero.
        name: The camera name; see ``known_camera``.
        joints: All joints (n,) of the resting arm; measured if None.

    Raises:
        BadValueError: A pixel is not in the picture.
        CalibrationError: The arm has no such calibrated camera, the camera has moved, the
            calibration already determines this zero or has changed since the arm was opened, the
            zero is hardly visible, the arm is moving, or no plausible zero fits a click.
    """
    camera, _, name = known_camera(arm.context, name)
    model, chain = arm.camera.named(name).model(), arm.chain
    joint, rays = chain.names[-1], [model.ray(*pixel) for pixel in pixels]
    calibration = ArmBefore.of(arm).calibration
    if calibration is None:
        raise CalibrationError("The zeros of a simulated arm are exact; a click cannot set them.")
    if camera.tip_shows != joint:
        raise CalibrationError(
            f"A click on the tip cannot set the zero of {joint}.",
            "The board's pictures already determine this zero, or the joint hardly moves the tip.",
        )
    _require_same(arm, calibration)
    joints = _resting_joints(arm) if joints is None else joints
    q, last = arm.joint_index.chain_joints(joints), np.eye(chain.dof)[-1]
    found = [_read_click(arm, model, camera, ray, joints) for ray in rays]
    cameras = calibration.cameras_by_name
    old = [click for each in cameras.values() for click in each.tip_clicks]
    clicks = [*old, *(click for click, _ in found)]
    mean_deg, error_deg, counts, are_apart = _mean(clicks)
    moved = q + math.radians(mean_deg) * last
    tip_m, then_m = chain.forward(np.array([moved, moved + math.radians(1.0) * last]))[:, :3, 3]
    error_mm = 1000.0 * error_deg * float(np.linalg.norm(then_m - tip_m))
    is_known = counts.sum() >= _ENOUGH and error_mm < max(_KNOWN_MM, 2.0 * camera.after_mm)
    kept = (*camera.tip_clicks, *clicks[len(old) :])
    cameras[name] = camera.model_copy(update={"tip_clicks": kept})
    return TipZero(
        joint,
        math.radians(mean_deg),
        float(np.linalg.norm(np.cross(tip_m - rays[-1].origin_m, rays[-1].direction))),
        found[-1][1],
        tuple(click.off_deg - mean_deg for click in clicks),
        tuple(counts.tolist()),
        are_apart,
        error_deg,
        error_mm / 1000.0,
        ""
        if is_known
        else f"More clicks improve the result. {_next_posture(arm, model, joints)}".rstrip(),
        calibration,
        _with_last_zero(arm, calibration.with_cameras(cameras), q, moved, written),
    )


def save_tip_zero(arm: Arm, found: TipZero) -> Path:
    """Save a zero, and return the file; ``undo_calibration`` undoes this.

    Raises:
        CalibrationError: The calibration has changed since the click.
        FileWriteError: The calibration cannot be saved.
    """
    if ArmBefore.of(arm).calibration != found.before:
        raise CalibrationError(
            "The calibration has changed since the click.", "Open the arm again, then click."
        )
    return save_calibration(found.calibration)


def _read_click(
    arm: Arm, model: CameraModel, camera: CalibratedCamera, ray: Ray, joints: Vector
) -> tuple[TipClick, float]:
    """Evaluate a click; return it, and the motion of the tip in pixels per degree of the joint."""
    chain, q = arm.chain, arm.joint_index.chain_joints(joints)
    steps = np.arange(-_MOST_RAD, _MOST_RAD, _STEP_RAD)
    tried = q + steps[:, None] * np.eye(chain.dof)[-1]
    tips_m = chain.forward(tried)[:, :3, 3]
    off_m = np.linalg.norm(np.cross(tips_m - ray.origin_m, ray.direction), axis=1)
    best = int(np.argmin(off_m))
    hint = (
        "Click where the tip is, between the fingertips, in a picture of the arm in its "
        "present position."
    )
    beside_mm = 1000.0 * float(off_m[best])
    if beside_mm > _OFF_MM + 2.0 * camera.after_mm:
        raise CalibrationError(
            f"The click is {beside_mm:.0f} mm or more from every position that the tip can reach.",
            hint,
        )
    px_per_deg = float(_px_per_deg(model, chain, tried[best : best + 1])[0])
    if px_per_deg < _LEAST_PX:
        raise CalibrationError(
            f"Each degree of {chain.names[-1]} moves the tip by {px_per_deg:.1f} pixels in this "
            "picture, which is too little.",
            _next_posture(arm, model, joints)
            or "Calibrate with a camera that sees the arm from its side.",
        )
    if best in (0, len(steps) - 1):
        most_deg = math.degrees(_MOST_RAD)
        raise CalibrationError(
            f"According to the click, the zero of {chain.names[-1]} is off by {most_deg:.0f}° "
            "or more.",
            hint,
        )
    px_per_mm = float(model.lens.matrix[0, 0] / model.project(tips_m[best])[1]) / 1000.0
    click = TipClick(
        off_deg=math.degrees(steps[best]),
        click_deg=_CLICK_PX / px_per_deg,
        camera_deg=camera.after_mm * px_per_mm / px_per_deg,
    )
    return click, px_per_deg


def _mean(clicks: Sequence[TipClick]) -> tuple[float, float, NDArray[np.bool_], bool]:
    """Return mean and standard error [deg] of clicks, a mask (n,) of those used, and are_apart.

    If clicks scatter more than expected, the standard error is enlarged accordingly.
    """
    off, click, camera = np.array([tuple(each.model_dump().values()) for each in clicks]).T
    counts = np.ones(len(clicks), dtype=bool)
    while True:
        weight = counts / (click**2 + camera**2)
        total, others = weight.sum(), np.maximum(weight.sum() - weight, 1e-12)
        mean_deg = float(weight @ off / total)
        doubt = np.abs(off - mean_deg) * np.sqrt(weight * total / others)  # from the others' mean
        is_doubtful = bool(doubt.max() > _DOUBTFUL)
        if not is_doubtful or counts.sum() == 2:
            scatter = weight @ (off - mean_deg) ** 2 / max(counts.sum() - 1, 1)
            own = math.sqrt(max(1.0, scatter)) * np.linalg.norm(weight * click)
            error_deg = math.hypot(own, weight @ camera) / total
            return mean_deg, float(error_deg), counts, is_doubtful
        counts[np.argmax(doubt)] = False


def _resting_joints(arm: Arm) -> Vector:
    """Return all measured joints (n,) of an arm at rest."""

    def read() -> Iterable[float]:
        return arm.where().positions_rad.tolist()

    still = read_until_at_rest(_STANDS, read, arm.clock, timeout_s=_STANDS.window_s)
    if not still.is_at_rest():
        raise CalibrationError("The arm is moving.", "Click when it has come to rest.")
    return np.array(still.joints)


def _require_same(arm: Arm, calibration: Calibration) -> None:
    """Check that the arm's joints are measured with the zeros of a calibration."""
    present = {each.joint: each.joint_map for each in arm.context.servos.driven_joints}
    for own in chain_maps(arm.model, calibration):
        turn_ticks = math.tau / own.horn_rad_per_tick
        apart = math.remainder(own.zero_tick - present[own.joint].zero_tick, turn_ticks)
        if abs(apart) > _SAME_TICK:
            raise CalibrationError(
                "The calibration has changed since the arm was opened.", "Open the arm again."
            )


def _px_per_deg(model: CameraModel, chain: Chain, q: Matrix, edge_px: float = 0.0) -> Vector:
    """Return how far the tip moves (n,) at joints (n, dof), pixels per degree of the last joint.

    The motion is 0 if the tip is not in front of the camera or is too near the picture's edge.
    """
    (px, depth_m), (then, _) = (
        model.project(chain.forward(each)[:, :3, 3])
        for each in (q, q + math.radians(1.0) * np.eye(chain.dof)[-1])
    )
    inside = np.minimum(px, model.lens.size - px).min(axis=1) > edge_px
    return np.where(inside & (depth_m > 0.0), np.linalg.norm(then - px, axis=1), 0.0)


def _next_posture(arm: Arm, model: CameraModel, joints: Vector) -> str:
    """Return advice on the joint motion from ``joints`` (n,) that shows the zero best.

    A click has a smaller error nearer to the camera, and its error depends on the direction of the
    fingers and on the camera's error, which differs by posture. The advice is empty if no motion
    helps.
    """
    chain, index, checker = arm.chain, arm.joint_index, arm.context.checked_collision
    low, high = (np.clip(each, -math.pi, math.pi) for each in arm.context.limits())
    kinds = zip(index.chain, chain.kinds, strict=True)
    turning = [i for i, kind in kinds if kind is JointType.REVOLUTE]
    tried = np.tile(joints, (len(turning), _POSTURES, 1))
    for row, i in zip(tried, turning, strict=True):
        row[:, i] = np.linspace(low[i], high[i], _POSTURES)
    tried = tried[np.abs(tried - joints).max(axis=2) > _APART_RAD]
    if checker is not None:
        tried = tried[checker.collision_free(index.body_joints(tried))]
    shown = _px_per_deg(model, chain, index.chain_joints(tried), _EDGE_PX)
    if shown.max(initial=0.0) < _LEAST_PX:
        return ""
    best = tried[np.argmax(shown)]
    i = int(np.argmax(np.abs(best - joints)))
    return f"Move {index.names[i]} to {math.degrees(best[i]):.0f}° and click again."


def _with_last_zero(
    arm: Arm, calibration: Calibration, q: Vector, moved: Vector, written: datetime
) -> Calibration:
    """Return the calibration with zeros that make joints q (dof,) read ``moved``.

    Boards on the gripper keep their poses in the base frame.
    """
    joints = shift_zeros(calibration.joints, chain_maps(arm.model, calibration), moved - q)
    T_moved_tip = np.linalg.inv(arm.chain.forward(moved)) @ arm.chain.forward(q)
    cameras: dict[str, CalibratedCamera] = {}
    shift_deg = math.degrees(moved[-1] - q[-1])
    for name, camera in calibration.cameras_by_name.items():
        board = camera.board
        if board is not None:
            board = seen_board(board.name, T_moved_tip @ stored_pose(board), board.scale)
        clicks = tuple(
            click.model_copy(update={"off_deg": click.off_deg - shift_deg})
            for click in camera.tip_clicks
        )
        cameras[name] = camera.model_copy(update={"board": board, "tip_clicks": clicks})
    changed = calibration.model_copy(update={"joints": joints, "written": written})
    return changed.with_cameras(cameras)
