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
Pose = Annotated[str, typer.Option("--pose", help="The pose that the arm is held in at first.")]
Margin = Annotated[
    float, typer.Option("--margin", min=0.0, max=20.0, help="Degrees inside each end found.")
]
FromScript = Annotated[
    Path | None, typer.Option("--from-script", metavar="FILE", help="Answers, one a line.")
]
NoInput = Annotated[bool, typer.Option("--no-input", help="Never ask; a question is an error.")]
Free = Annotated[
    list[str] | None, typer.Option("--free", metavar="JOINT", help="Nothing stops this joint.")
]
Skip = Annotated[
    list[str] | None, typer.Option("--skip", metavar="JOINT", help="Leave it to the arm file.")
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
    bool, typer.Option("--touch", help="Touch known points: zeros, links and base made exact.")
]
Points = Annotated[
    Path | None,
    typer.Option("--points", metavar="FILE", help="Points to touch: NAME X Y Z, one a line."),
]
SamePoint = Annotated[
    bool, typer.Option("--same-point", help="Touch one unmeasured point again and again.")
]
SheetAt = Annotated[
    float | None,
    typer.Option(
        "--sheet-at", parser=parse_length_m, help="From the base to the sheet's near edge."
    ),
]
Block = Annotated[
    float | None,
    typer.Option("--block", parser=parse_length_m, help="Height of a block for every other cross."),
]
Auto = Annotated[
    bool, typer.Option("--auto", help="The arm finds its ranges itself, gently, stop by stop.")
]
Wiggle = Annotated[
    bool, typer.Option("--wiggle", help="Each joint a little and back: is it the right one?")
]
