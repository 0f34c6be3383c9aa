"""``ikservo camera``: make boards, check whether a camera has moved, and click the tip."""

from __future__ import annotations

import os
import re
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ikservo.apps.cameras.board import Board
from ikservo.cli.camera_options import DEFAULT_BOARD, BoardOption, CameraNameOption
from ikservo.cli.completion import complete_from
from ikservo.cli.options import JsonOption, OverwriteOption, ServoPortOption
from ikservo.cli.quantities import parse_length_m, parse_pixels
from ikservo.cli.terminal import print_json, print_lines, print_status
from ikservo.errors import BadValueError, ExitCode, InputError, UnknownNameError, shown
from ikservo.files.writing import write_atomic

if TYPE_CHECKING:
    from ikservo.apps.cameras.board_detection import PictureSource
    from ikservo.arm.arm import Arm

__all__ = ["BoardOption", "CameraNameOption", "check_camera_name", "command", "open_camera"]

ACTIONS = {
    "board": ("--board", "--overwrite"),
    "check": ("--board", "--camera", "--camera-name", "--remember", "--within"),
    "tip": ("--camera-name", "--at"),
}
"""The actions, with the options of each besides --port and --json."""
Action = Annotated[
    str,
    typer.Argument(
        metavar="board|check|tip",
        autocompletion=complete_from(*ACTIONS),
        help="board: write a board to a file. check: see whether the camera has moved. tip: "
        "find the last joint's zero from the pixel of the tip.",
    ),
]
File = Annotated[
    Path | None,
    typer.Argument(
        metavar="[FILE|ARM]",
        help="For board: a file of type .pdf or .svg. Otherwise: the arm in front of the camera.",
    ),
]
CameraOption = Annotated[
    str | None,
    typer.Option("--camera", metavar="SOURCE", help="A number, a device, an address, or sim."),
]
Remember = Annotated[
    bool,
    typer.Option("--remember", help="Remember where a board lies on the table, for later checks."),
]
Within = Annotated[
    float | None,
    typer.Option(
        "--within",
        parser=parse_length_m,
        metavar="LENGTH",
        help="Largest accepted shift of the board; default: 3mm plus the error of the arm.",
    ),
]
At = Annotated[
    list[str] | None,
    typer.Option(
        "--at",
        metavar="U,V",
        help="The pixel of the tip, from the top left corner; may be repeated.",
    ),
]


def command(
    action: Action,
    file: File = None,
    *,
    board: BoardOption = DEFAULT_BOARD,
    camera: CameraOption = None,
    camera_name: CameraNameOption = "",
    remember: Remember = False,
    within: Within = None,
    at: At = None,
    overwrite: OverwriteOption = False,
    port: ServoPortOption = None,
    json: JsonOption = False,
) -> None:
    """Make a calibration board, check whether a camera has moved, or find a zero with a camera.

    A check uses the board on the gripper, as calibrated, or a remembered board on the table.
    Nothing moves. Exit code 6: the camera has moved; its pictures cannot give targets until it is
    back in place. Exit code 1: the picture does not show the board. If a board cannot show the zero
    of the last joint, tip finds and saves it from the tip's pixel in a picture. More pixels improve
    the result, most of all pixels in the different posture that the command proposes.

    ikservo camera board board.svg --board 7x9-15mm-5x5

    ikservo camera check so101 --camera 0

    ikservo camera check so101 --camera 0 --remember

    ikservo camera tip open_manipulator_x --at 512,300
    """
    if action not in ACTIONS:
        raise UnknownNameError("action", action, ACTIONS)
    check_camera_name(camera_name)
    given = {
        "--board": board != DEFAULT_BOARD,
        "--camera": camera is not None,
        "--camera-name": bool(camera_name),
        "--remember": remember,
        "--within": within is not None,
        "--at": bool(at),
        "--overwrite": overwrite,
    }
    for name, is_given in given.items():
        if is_given and name not in ACTIONS[action]:
            its = " and ".join(each for each, options in ACTIONS.items() if name in options)
            raise InputError(f"{name} cannot be given for {action}.", f"It only applies to {its}.")
    if action == "board":
        path = file or Path("board.pdf")
        if path.exists() and not overwrite:
            raise InputError(f"{path} exists.", "Choose another file, or add --overwrite.")
        _write_board(path, Board.named(board), json=json)
        return
    arm = (file and str(file)) or os.environ.get("IKSERVO_ARM")
    if action == "tip":
        if not at:
            raise InputError("No pixel of the tip was given.", "Add its pixel: --at 512,300")
        _set_tip_zero(arm, port, [_parse_pixel(each) for each in at], camera_name, json=json)
        return
    if camera is None:
        raise InputError("No camera was given.", "Add: --camera 0")
    if within is not None and not 0.0 < within < 1.0:
        raise BadValueError("--within", within, "a length above 0 and below 1 m")
    _check(arm, port, camera, camera_name, Board.named(board), within,
           remember=remember, json=json)  # fmt: skip


def _write_board(file: Path, board: Board, *, json: bool) -> None:
    if file.suffix not in (".pdf", ".svg"):
        raise BadValueError("The file", str(file), "a name that ends with .pdf or .svg")
    write_atomic(file, board.svg() if file.suffix == ".svg" else board.pdf().decode("ascii"))
    if json:
        print_json("camera-board", path=file, board=board.name)
        return
    print_lines([f"Wrote {file}: {board.name}"])
    print_status(
        "Print the board at 100 %, check the line below it with a ruler, and glue the board on "
        "something flat."
    )


def _check(
    arm: str | None,
    port: str | None,
    source: str,
    name: str,
    board: Board,
    within_m: float | None,
    *,
    remember: bool,
    json: bool,
) -> None:
    from ikservo.apps.cameras.camera_check import remember_board  # noqa: PLC0415
    from ikservo.arm.opening import require_own_port  # noqa: PLC0415  # loads the kernels
    from ikservo.cli.open_and_confirm import open_from_options  # noqa: PLC0415
    from ikservo.cli.options import ArmConnection  # noqa: PLC0415

    with open_from_options(ArmConnection(arm=arm, port=port)) as machine:
        opened = require_own_port(machine)
        camera = open_camera(source, opened, board)
        if not remember:
            _compare(opened, camera, within_m, name, json=json)
            return
        stored = remember_board(opened, camera, board, name)
        if json:
            at_m = [each / 1000.0 for each in stored.at_mm]
            print_json("camera-board-place", board=stored.name, at_m=at_m)
        else:
            at = ", ".join(f"{each:.0f}" for each in stored.at_mm)
            print_lines([f"Remembered {stored.name} at ({at}) mm. Leave the board there."])


def open_camera(source: str, arm: Arm, board: Board) -> PictureSource:
    """Open a camera in front of an arm, and print its hint.

    Raises:
        InputError: OpenCV is not installed, or there is no such camera.
    """
    from ikservo.apps.cameras.camera_sources import open_source  # noqa: PLC0415

    camera = open_source(source, arm.context.port.transport, board)
    if camera.hint:
        print_status(camera.hint)
    return camera


def check_camera_name(name: str) -> str:
    """Return the name of a camera.

    Raises:
        BadValueError: The text is not a valid name.
    """
    if not re.fullmatch(r"[A-Za-z0-9_-]{0,64}", name):
        raise BadValueError("--camera-name", shown(name), "at most 64 letters, digits, - and _")
    return name


def _compare(
    arm: Arm, camera: PictureSource, within_m: float | None, name: str, *, json: bool
) -> None:
    from ikservo.apps.cameras.camera_check import check_camera  # noqa: PLC0415

    now = datetime.now(UTC).replace(microsecond=0)
    check, place = check_camera(arm, camera, now, within_m and 1000.0 * within_m, name)
    if json:
        print_json(
            "camera-check",
            moved=check.has_moved,
            moved_m=check.moved_mm / 1000.0,
            turned_deg=check.turned_deg,
            off_m=check.off_mm / 1000.0,
            board="table" if place.on_table else "gripper",
        )
    else:
        where = "on the table" if place.on_table else "on the gripper"
        moved = "has moved" if check.has_moved else "has not moved"
        print_lines([
            f"The camera {moved}. Judged by the board {where}, it is off by {check.moved_mm:.1f} "
            f"mm and {check.turned_deg:.2f}°; the board appears {check.off_mm:.1f} mm from "
            "its place."
        ])  # fmt: skip
    if check.has_moved:
        print_status("Put the camera back and check again, or calibrate again.")
        raise typer.Exit(ExitCode.CALIBRATION)


def _parse_pixel(text: str) -> tuple[float, float]:
    try:
        u, v = map(parse_pixels, text.split(","))
    except (ValueError, typer.BadParameter):
        raise BadValueError("--at", shown(text), "two numbers, such as 512,300") from None
    return u, v


def _set_tip_zero(
    name: str | None,
    port: str | None,
    pixels: list[tuple[float, float]],
    camera: str,
    *,
    json: bool,
) -> None:
    from ikservo.apps.cameras.tip_click import find_tip_zero, save_tip_zero  # noqa: PLC0415
    from ikservo.arm.opening import require_own_port  # noqa: PLC0415  # loads the kernels
    from ikservo.cli.open_and_confirm import open_from_options  # noqa: PLC0415
    from ikservo.cli.options import ArmConnection  # noqa: PLC0415

    with open_from_options(ArmConnection(arm=name, port=port)) as machine:
        arm, now = require_own_port(machine), datetime.now(UTC).replace(microsecond=0)
        found = find_tip_zero(arm, pixels, now, camera)
        path = save_tip_zero(arm, found)
    if json:
        print_json(
            "camera-tip", path=path, joint=found.joint, shift_rad=found.shift_rad,
            off_m=found.off_m, px_per_deg=found.px_per_deg, clicks=len(found.counts),
            counted=sum(found.counts), counts=found.counts, error_deg=found.error_deg,
            error_m=found.error_m, advice=found.advice,
        )  # fmt: skip
        return
    print_lines([str(found)])
    print_status(f"Saved to {path}. To undo the click: ikservo calibration undo {arm.model.name}")
    if found.advice:
        print_status(found.advice)
