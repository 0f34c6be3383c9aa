"""The dialogue of a calibration by camera: place the board, take pictures, and save the result."""

from __future__ import annotations

import math
import shlex
import shutil
from collections.abc import Callable, Generator, Iterator
from contextlib import AbstractContextManager, contextmanager
from datetime import UTC, datetime
from pathlib import Path

from ikservo.apps.cameras.board import Board
from ikservo.apps.cameras.board_detection import PictureSource
from ikservo.apps.cameras.camera_and_arm_fit import MIN_SAMPLES
from ikservo.apps.cameras.camera_by_hand import HandCalibration
from ikservo.apps.cameras.camera_calibration import (
    PRINTED_COMPLIANCE,
    ArmBefore,
    CameraCalibration,
    CameraResult,
    save_camera_result,
)
from ikservo.apps.cameras.picture_folder import PictureFolder, PictureIndex
from ikservo.arm.arm import Arm
from ikservo.calibration.paths import pictures_path
from ikservo.cli.camera_options import CameraOptions
from ikservo.control.stop_requests import exiting_on_signals
from ikservo.errors import IkservoError
from ikservo.files.public_source import public_source
from ikservo.maintenance.dialogue import ACCEPT, Dialogue, Notice, Question, Unasked


def calibrate_with_camera(
    arm: Arm,
    camera: PictureSource,
    options: CameraOptions,
    on_status: Callable[[str], None],
    attended: Callable[[Arm], AbstractContextManager[None]],
) -> Dialogue[tuple[ArmBefore, CameraResult, Path | None]]:
    """Let the arm show its board to a camera, and estimate the camera and the arm.

    ``on_status`` receives a line about what is kept after a failure; ``attended`` makes the context
    in which the arm moves itself. In a calibration by hand, the arm is limp and the user moves it.

    Returns:
        The arm before the calibration, the result, which is not saved yet, and the folder of
        pictures that ``kept_until_saved`` removes; None if the user has chosen it.

    Raises:
        CalibrationError: The board is not seen, or the arm has no calibration.
        IkservoError: The user declined; nothing moved.
        StoppedError: The user stopped the arm, which holds.
    """
    board, before = Board.named(options.board), ArmBefore.of(arm)
    name, chosen = options.camera_name, options.save_pictures is not None
    yield Notice(
        f"Fix the board {board.name} to the gripper, in front of the camera and about in the "
        "middle of its picture. "
        + (
            "Torque will be switched off: hold the arm. Then move it, and keep it still for a "
            "second in many postures, about one for each picture requested."
            if options.by_hand
            else "The arm will then show the board to the camera from all over its reach."
        )
    )
    if (yield Question("Begin?", Unasked.ERROR, label="begin")) != ACCEPT:
        raise IkservoError("Nothing moved.")
    with attended(arm):
        index = PictureIndex(
            arm=arm.model.name, source=public_source(options.camera or ""), camera_name=name,
            board=board.name, by_hand=options.by_hand, joints=arm.chain.names,
        )  # fmt: skip
        path = options.save_pictures or pictures_path(arm.model.name, datetime.now(UTC))
        folder = PictureFolder(path, index, before.calibration)
        if options.by_hand:
            arm.disable_torque()
        extents = before.extents(name, by_hand=options.by_hand)
        session = (HandCalibration if options.by_hand else CameraCalibration)(
            arm, camera, board, options.pictures, extents, folder
        )
        with _kept_at_failure(path, arm.model.name, on_status, chosen=chosen):
            result = yield from session.run()
    return before, result, None if chosen else path


@contextmanager
def kept_until_saved(
    pictures: Path | None, arm: str, on_status: Callable[[str], None]
) -> Generator[None]:
    """Remove a folder of pictures after the ``with`` block; if it fails, tell how to use it."""
    if pictures is None:
        yield
        return
    try:
        yield
    except BaseException:
        on_status(f"The pictures are kept. To calibrate with them: {_again(arm, pictures)}")
        raise
    shutil.rmtree(pictures, ignore_errors=True)


def _again(arm: str, pictures: Path) -> str:
    """Return the command that calibrates with pictures."""
    return f"ikservo calibrate {shlex.quote(arm)} --from-pictures {shlex.quote(str(pictures))}"


@contextmanager
def _kept_at_failure(
    folder: Path, arm: str, on_status: Callable[[str], None], *, chosen: bool
) -> Generator[None]:
    """Tell the user how to continue if the calibration ends early.

    The folder is kept if its pictures suffice for a calibration. A folder that the user has
    ``chosen`` is kept even if it has only one picture.
    """
    try:
        with exiting_on_signals():  # also while no motion runs
            yield
    except BaseException:
        taken = len(list(folder.glob("*.png")))
        if taken >= MIN_SAMPLES:
            again = _again(arm, folder)
            on_status(f"The {taken} pictures so far are kept. To calibrate with them: {again}")
        elif taken:
            needed = f"a calibration needs at least {MIN_SAMPLES}. Start it again."
            on_status(f"Only {taken} pictures were taken; {needed}")
        if taken < MIN_SAMPLES and not (taken and chosen):
            shutil.rmtree(folder, ignore_errors=True)
        raise


def save_result(
    before: ArmBefore, source: str, name: str, result: CameraResult, question: Question
) -> Dialogue[Path | None]:
    """Save a result if the user agrees, and tell how to undo it; return the path of its file."""
    if (yield question) != ACCEPT:
        return None
    now = datetime.now(UTC).replace(microsecond=0)
    path = save_camera_result(before, source, result, now, name)
    if before.calibration is None:
        yield Notice(f"A simulated arm has no calibration. Its camera was saved to {path}.")
        yield Notice(
            "In the start pose the board faces the camera. To check it, with the same --port: "
            "ikservo camera check"
        )
        return path
    arm = before.model.name
    yield Notice(f"Saved to {path}. To undo it: ikservo calibration undo {arm}")
    if result.tip_shows:
        command = f"ikservo camera tip {arm} --at U,V"
        yield Notice(f"To find the zero of {result.tip_shows} from clicks on the tip: {command}")
    return path


def describe_result(result: CameraResult) -> Iterator[str]:
    """Yield lines that describe the result of the calibration."""
    estimate, fit = result.estimate, result.estimate.fit
    yield (
        f"{result.pictures} pictures in {result.duration_s:.0f} s. Error in test pictures: "
        f"{_mm(estimate.before_m)} before, {_mm(estimate.after_m)} now "
        f"(estimated: {fit.extent.value})."
    )
    left_out = [f"picture {i + 1}" for i, kept in enumerate(fit.kept.tolist()) if not kept]
    if left_out:
        yield f"Outliers, not used: {', '.join(left_out)}."
    for parameter in fit.parameters:
        if parameter.is_determined:
            value, deviation = parameter.value, parameter.deviation
            if parameter.unit == "rad":
                said = f"{math.degrees(value):.2f}° ± {math.degrees(deviation):.2f}°"
            else:
                said = f"{value:.4g} ± {deviation:.2g} {parameter.unit}"
            yield f"{parameter.name}: {said}"
    if result.carried is not None:
        yield (
            "According to the calibrated bending of the links, the arm carried about "
            f"{result.carried:.0%} of its weight in the pictures, and the hand carried the rest."
        )
    if result.sag_m is not None:
        yield (
            "The bending of the links is unknown, and a hand that carries the arm hides the "
            "bending. When the arm carries itself, the tip error is larger than these figures, "
            f"by about {_mm(result.sag_m)} if each joint bends by {PRINTED_COMPLIANCE} rad per "
            "N m, as printed joints do. A calibration without --by-hand measures the bending."
        )
    unknown = [each.name for each in fit.parameters if not each.is_determined]
    if unknown:
        yield f"Not determined by these pictures, and therefore unchanged: {', '.join(unknown)}."
    if abs(fit.scale) > 0.01:
        yield f"The board seems to be {1.0 + fit.scale:.1%} of the size in its name."


def _mm(metres: float) -> str:
    return f"{1000.0 * metres:.1f} mm"
