"""The options that many commands share, each written once."""

from __future__ import annotations

from typing import Annotated

import typer

from ikservo.cli.completing import arms, speeds
from ikservo.cli.quantities import parse_length_m

__all__ = [
    "ArmOption",
    "CollisionOption",
    "DryRunOption",
    "JsonOption",
    "Length",
    "NoWiggleOption",
    "PortOption",
    "SpeedOption",
    "TipOption",
    "UncalibratedOption",
    "YesOption",
]

ArmOption = Annotated[
    str | None,
    typer.Option(
        "--arm",
        envvar="IKSERVO_ARM",
        help="Arm: a name of `ikservo arms`, or a file.",
        autocompletion=arms,
    ),
]
PortOption = Annotated[
    str | None,
    typer.Option("--port", envvar="IKSERVO_PORT", help="Serial port, or `sim` for no hardware."),
]
JsonOption = Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")]
YesOption = Annotated[
    bool,
    typer.Option("--yes", "-y", help="Do not ask; required without a terminal, for a real arm."),
]
CollisionOption = Annotated[
    bool,
    typer.Option("--collision/--no-collision", help="Check the path for collisions before moving."),
]
DryRunOption = Annotated[bool, typer.Option("--dry-run", help="Plan and print, but do not move.")]
SpeedOption = Annotated[
    str, typer.Option("--speed", help="slow, normal or fast.", autocompletion=speeds)
]
Length = Annotated[float, typer.Argument(parser=parse_length_m, help="Metres, or like 120mm.")]
TipOption = Annotated[
    str | None,
    typer.Option("--tip", help="Link that is the tool; needed for a .urdf."),
]
UncalibratedOption = Annotated[
    bool,
    typer.Option(
        "--uncalibrated",
        help="Use the arm file's nominal zeros instead of a calibration.",
    ),
]
NoWiggleOption = Annotated[
    bool,
    typer.Option("--no-wiggle", help="Skip the test motion of each joint after its files changed."),
]
