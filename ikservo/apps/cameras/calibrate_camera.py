"""``ikservo calibrate --camera``: calibrate camera and arm from pictures of a board."""

from __future__ import annotations

from pathlib import Path

from ikservo.apps.cameras.board import Board, require_opencv
from ikservo.apps.cameras.board_detection import find_board
from ikservo.apps.cameras.camera_calibration import (
    ESTIMATING,
    ArmBefore,
    BoardPictures,
    CameraResult,
)
from ikservo.apps.cameras.camera_command import check_camera_name, open_camera
from ikservo.apps.cameras.camera_dialogue import (
    calibrate_with_camera,
    describe_result,
    kept_until_saved,
    save_result,
)
from ikservo.apps.cameras.picture_folder import PictureFolder, read_pictures
from ikservo.arm.opening import require_own_port
from ikservo.cli.camera_options import CameraOptions
from ikservo.cli.open_and_confirm import open_from_options
from ikservo.cli.options import MotionOptions, NamedServoConnection
from ikservo.cli.second_interrupt import second_interrupt_lowers
from ikservo.cli.terminal import print_json, print_lines, print_status
from ikservo.cli.terminal_dialogue import Operator
from ikservo.errors import CalibrationError
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
        before, result, pictures = operator.run(
            calibrate_with_camera(arm, camera, options, print_status, second_interrupt_lowers)
        )
        question = Question("Save this?", Unasked.YES)
        with kept_until_saved(pictures, before.model.name, print_status):
            _tell_and_save(before, source, name, result, operator, question, json=json)


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
    print_status(f"{ESTIMATING}.")
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
        print_status("\n".join(describe_result(result)))
    else:
        print_lines(describe_result(result), indent=2)
    path = operator.run(save_result(before, source, name, result, question))
    if json:
        print_json("calibrate-camera", path=path, **_fields(result))


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
