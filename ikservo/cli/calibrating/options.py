"""The options of the commands that calibrate, each written once."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ikservo.cli.quantities import parse_length_m

__all__ = [
    "ArmWord",
    "Auto",
    "Block",
    "Free",
    "FromScript",
    "Margin",
    "NoInput",
    "OnlyJoint",
    "OwnLimit",
    "Points",
    "Pose",
    "SamePoint",
    "SheetAt",
    "Skip",
    "TouchOff",
    "Wiggle",
    "WriteLimits",
]

ArmWord = Annotated[
    str | None,
    typer.Argument(metavar="[ARM]", envvar="IKSERVO_ARM", help="Arm: a name or an arm file."),
]
Pose = Annotated[
    str, typer.Option("--pose", help="The named pose in which you hold the arm at first.")
]
Margin = Annotated[
    float,
    typer.Option(
        "--margin", min=0.0, max=20.0, help="Degrees between each end stop and the limit."
    ),
]
FromScript = Annotated[
    Path | None, typer.Option("--from-script", metavar="FILE", help="Answers, one a line.")
]
NoInput = Annotated[bool, typer.Option("--no-input", help="Never ask; a question is an error.")]
Free = Annotated[
    list[str] | None, typer.Option("--free", metavar="JOINT", help="This joint has no end stops.")
]
Skip = Annotated[
    list[str] | None,
    typer.Option("--skip", metavar="JOINT", help="Use the arm file's range and sign."),
]
OnlyJoint = Annotated[
    list[str] | None,
    typer.Option("--joint", metavar="JOINT", help="Calibrate only this joint again."),
]
OwnLimit = Annotated[
    list[str] | None,
    typer.Option("--limit", metavar="JOINT=LOW:HIGH", help="A narrower range of your own."),
]
WriteLimits = Annotated[
    bool | None,
    typer.Option(
        "--write-limits/--no-write-limits", help="Whether the servos hold the limits, too."
    ),
]

TouchOff = Annotated[
    bool,
    typer.Option("--touch", help="Touch-off: measure zeros, links and base by touching points."),
]
Points = Annotated[
    Path | None,
    typer.Option("--points", metavar="FILE", help="Points to touch: NAME X Y Z, one a line."),
]
SamePoint = Annotated[
    bool, typer.Option("--same-point", help="Touch one fixed point of unknown position repeatedly.")
]
SheetAt = Annotated[
    float | None,
    typer.Option(
        "--sheet-at",
        parser=parse_length_m,
        help="Distance from the base to the near edge of the sheet.",
    ),
]
Block = Annotated[
    float | None,
    typer.Option("--block", parser=parse_length_m, help="Height of a block for every other cross."),
]
Auto = Annotated[
    bool, typer.Option("--auto", help="The arm drives gently to its end stops by itself.")
]
Wiggle = Annotated[
    bool,
    typer.Option("--wiggle", help="Test motion: each joint 5° and back, to check ids and signs."),
]
