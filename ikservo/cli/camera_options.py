"""The options for a camera and its board, which several commands share."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

DEFAULT_BOARD = "5x7-12mm-4x4"

BoardOption = Annotated[
    str, typer.Option("--board", metavar="NAME", help="Board, as COLUMNSxROWS-SQUAREmm-FAMILY.")
]
CameraNameOption = Annotated[
    str,
    typer.Option("--camera-name", metavar="NAME", help="Name of the camera, if there are several."),
]


@dataclass(frozen=True, kw_only=True)
class CameraOptions:
    """The camera of a calibration, and the board that it sees."""

    camera: Annotated[
        str | None,
        typer.Option(
            "--camera",
            metavar="SOURCE",
            help="Show a printed board to this camera: a number, a device, an address, or sim.",
        ),
    ] = None
    board: BoardOption = DEFAULT_BOARD
    pictures: Annotated[
        int, typer.Option("--pictures", min=10, max=100, help="Number of pictures.")
    ] = 30
    camera_name: CameraNameOption = ""
    save_pictures: Annotated[
        Path | None,
        typer.Option(
            "--save-pictures",
            metavar="FOLDER",
            help="Keep the pictures and joint readings in this new folder.",
        ),
    ] = None
    from_pictures: Annotated[
        Path | None,
        typer.Option(
            "--from-pictures",
            metavar="FOLDER",
            help="Repeat a calibration from the pictures in this folder, without arm or camera.",
        ),
    ] = None
    by_hand: Annotated[
        bool,
        typer.Option(
            "--by-hand", help="With --camera: move the limp arm by hand in view of the camera."
        ),
    ] = False
