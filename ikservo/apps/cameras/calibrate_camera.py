"""``ikservo calibrate --camera``: calibrate camera and arm from pictures of a board."""

from __future__ import annotations

import math
import shlex
import shutil
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

from ikservo.apps.cameras.board import Board, require_opencv
from ikservo.apps.cameras.board_detection import find_board
from ikservo.apps.cameras.camera_and_arm_fit import MIN_SAMPLES
from ikservo.apps.cameras.camera_by_hand import HandCalibration
from ikservo.apps.cameras.camera_calibration import (
    ESTIMATING,
    PRINTED_COMPLIANCE,
    ArmBefore,
    BoardPictures,
    CameraCalibration,
    CameraResult,
    save_camera_result,
)
from ikservo.apps.cameras.camera_command import check_camera_name, open_camera
from ikservo.apps.cameras.picture_folder import PictureFolder, PictureIndex, read_pictures
from ikservo.arm.opening import require_own_port
from ikservo.calibration.paths import pictures_path
from ikservo.cli.camera_options import CameraOptions
from ikservo.cli.open_and_confirm import open_from_options
from ikservo.cli.options import MotionOptions, NamedServoConnection
from ikservo.cli.second_interrupt import second_interrupt_lowers
from ikservo.cli.terminal import print_json, print_lines, print_status
from ikservo.cli.terminal_dialogue import Operator
from ikservo.control.stop_requests import exiting_on_signals
from ikservo.errors import CalibrationError, IkservoError
from ikservo.files.public_source import public_source
from ikservo.maintenance.dialogue import Question, Unasked
from ikservo.model import Model


def calibrate_by_camera(
    connection: NamedServoConnection, options: CameraOptions, operator: Operator, *, json: bool
) -> None:
    """Let the arm show its board to a camera; print the result, and save it if the user agrees.

    In a calibration by hand, the arm is limp and the user moves it.

    Raises:
        CalibrationError: The board is not seen, or the arm has no calibration.
        InputError: OpenCV is not installed, there is no such camera, or no user can be asked.
    """
    require_opencv()
    name = check_camera_name(options.camera_name)
    board, source = Board.named(options.board), options.camera or ""
    if options.save_pictures is not None:
        PictureFolder.require_new(options.save_pictures)
    with open_from_options(connection, MotionOptions()) as machine:
        arm = require_own_port(machine)
        camera = open_camera(source, arm, board)
        print_status(
            f"Fix the board {board.name} to the gripper, in front of the camera and about in the "
            "middle of its picture. "
            + (
                "Torque will be switched off: hold the arm. Then move it, and keep it still for a "
                "second in many postures, about one for each picture requested."
                if options.by_hand
                else "The arm will then show the board to the camera from all over its reach."
            )
        )
        if not operator.agrees(Question("Begin?", Unasked.ERROR)):
            raise IkservoError("Nothing moved.")
        with second_interrupt_lowers(arm):
            before = ArmBefore.of(arm)
            index = PictureIndex(
                arm=arm.model.name, source=public_source(source), camera_name=name,
                board=board.name, by_hand=options.by_hand, joints=arm.chain.names,
            )  # fmt: skip
            path = options.save_pictures or pictures_path(arm.model.name, datetime.now(UTC))
            folder = PictureFolder(path, index, before.calibration)
            if options.by_hand:
                arm.disable_torque()
            extents = before.extents(name, by_hand=options.by_hand)
            session = (HandCalibration if options.by_hand else CameraCalibration)(
                arm, camera, board, options.pictures, print_status, extents, folder
            )
            with _kept_at_failure(path, arm.model.name, chosen=options.save_pictures is not None):
                result = session.run()
        if options.save_pictures is None:
            shutil.rmtree(path)
        question = Question("Save this?", Unasked.YES)
        _tell_and_save(before, source, name, result, operator, question, json=json)


@contextmanager
def _kept_at_failure(folder: Path, arm: str, *, chosen: bool) -> Generator[None]:
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
            again = (
                f"ikservo calibrate {shlex.quote(arm)} --from-pictures {shlex.quote(str(folder))}"
            )
            print_status(f"The {taken} pictures so far are kept. To calibrate with them: {again}")
        elif taken:
            needed = f"a calibration needs at least {MIN_SAMPLES}. Start it again."
            print_status(f"Only {taken} pictures were taken; {needed}")
        if taken < MIN_SAMPLES and not (taken and chosen):
            shutil.rmtree(folder, ignore_errors=True)
        raise


def calibrate_from_pictures(model: Model, folder: Path, operator: Operator, *, json: bool) -> None:
    """Repeat a calibration from saved pictures and the calibration that the arm had then.

    Raises:
        CalibrationError: The pictures do not suffice.
        FileFormatError: The folder has no pictures of this arm, or a file in it is damaged.
    """
    require_opencv()
    saved = read_pictures(folder, model.name, model.chain.names)
    before = ArmBefore(model, saved.calibration)
    pictures, missed = BoardPictures(before, Board.named(saved.index.board)), 0
    for picture, q in saved.pictures():
        try:
            pictures.add(picture, find_board(pictures.board, picture), q)
        except CalibrationError:
            missed += 1
    print_status(ESTIMATING)
    index = saved.index
    extents = before.extents(index.camera_name, by_hand=index.by_hand)
    result = pictures.result(missed, 0.0, extents, by_hand=index.by_hand)
    question = Question("Save this?", Unasked.YES)
    if saved.calibration is not None:  # servos may have been remounted since then
        print_status(f"Saving it replaces any calibration made after {saved.calibration.written}.")
        question = Question("Save this result nevertheless?", Unasked.NEEDS_YES)
    _tell_and_save(before, index.source, index.camera_name, result, operator, question, json=json)


def _tell_and_save(
    before: ArmBefore,
    source: str,
    name: str,
    result: CameraResult,
    operator: Operator,
    question: Question,
    *,
    json: bool,
) -> None:
    if json:  # stdout has only the JSON, but the user must see what to decide
        print_status("\n".join(_describe(result)))
    else:
        print_lines(_describe(result), indent=2)
    path = None
    if operator.agrees(question):
        now = datetime.now(UTC).replace(microsecond=0)
        path = save_camera_result(before, source, result, now, name)
        if before.calibration is None:
            print_status(f"A simulated arm has no calibration. Its camera was saved to {path}.")
            print_status(
                "In the start pose the board faces the camera. To check it, with the same --port: "
                "ikservo camera check"
            )
        else:
            undo = f"ikservo calibration undo {before.model.name}"
            print_status(f"Saved to {path}. To undo it: {undo}")
            if result.tip_shows:
                command = f"ikservo camera tip {before.model.name} --at U,V"
                print_status(
                    f"To find the zero of {result.tip_shows} from clicks on the tip: {command}"
                )
    if json:
        print_json("calibrate-camera", path=path, **_fields(result))


def _describe(result: CameraResult) -> Iterator[str]:
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


def _fields(result: CameraResult) -> dict[str, object]:
    """Return the result of the calibration for ``--json``, in SI units."""
    estimate, fit = result.estimate, result.estimate.fit
    return {
        "pictures": result.pictures,
        "missed": result.missed,
        "left_out": [i + 1 for i, kept in enumerate(fit.kept.tolist()) if not kept],
        "duration_s": result.duration_s,
        "estimated": fit.extent.value,
        "before_m": estimate.before_m,
        "after_m": estimate.after_m,
        "board_scale": 1.0 + fit.scale,
        "tip_shows": result.tip_shows,
        "carried": result.carried,
        "sag_m": result.sag_m,
        "T_camera_base": fit.T_camera_base,
        "lens_px": result.intrinsics.matrix,
        "distortion": result.intrinsics.distortion,
        "parameters": [
            {
                "name": each.name,
                "unit": each.unit,
                "value": each.value,
                "deviation": each.deviation,
                "determined": each.is_determined,
            }
            for each in fit.parameters
        ],
    }
