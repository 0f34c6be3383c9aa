"""``ikservo camera``: the board that a camera looks at, to print."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ikservo.cli.completion import complete_from
from ikservo.cli.options import JsonOption
from ikservo.cli.terminal import print_json, print_lines, print_status
from ikservo.errors import BadValueError, UnknownNameError
from ikservo.eyes.board import DEFAULT_BOARD, Board
from ikservo.files.writing import write_atomic

__all__ = ["BoardOption", "command"]

ACTIONS = ("board",)
Action = Annotated[
    str,
    typer.Argument(
        metavar="board", autocompletion=complete_from(*ACTIONS), help="board: write it to a file."
    ),
]
File = Annotated[Path, typer.Argument(metavar="FILE", help="A file of type .pdf or .svg.")]
BoardOption = Annotated[
    str,
    typer.Option("--board", metavar="NAME", help="COLUMNSxROWS-SQUAREmm-FAMILY of the board."),
]


def command(
    action: Action,
    file: File = Path("board.pdf"),
    *,
    board: BoardOption = DEFAULT_BOARD,
    json: JsonOption = False,
) -> None:
    """Write the board that is fixed to the gripper for a calibration before a camera.

    ikservo camera board board.pdf

    ikservo camera board board.svg --board 7x9-15mm-5x5
    """
    if action not in ACTIONS:
        raise UnknownNameError("action", action, ACTIONS)
    chosen = Board.named(board)
    if file.suffix not in (".pdf", ".svg"):
        raise BadValueError("The file", str(file), "a name that ends with .pdf or .svg")
    write_atomic(file, chosen.svg() if file.suffix == ".svg" else chosen.pdf().decode("ascii"))
    if json:
        print_json("camera-board", path=file, board=chosen.name)
        return
    print_lines([f"Wrote {file}: {chosen.name}"])
    print_status(
        "Print it at 100 %, check the line below it with a ruler, and glue it on something flat."
    )
