"""The options that many commands share, each written once."""

from __future__ import annotations

from typing import Annotated

import typer

from ikservo.cli.completing import arms
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
YesOption = Annotated[bool, typer.Option("--yes", "-y", help="Do not ask before moving.")]
CollisionOption = Annotated[
    bool,
    typer.Option("--collision/--no-collision", help="Look at the body's way before moving."),
]
DryRunOption = Annotated[bool, typer.Option("--dry-run", help="Plan and print, but do not move.")]
SpeedOption = Annotated[str, typer.Option("--speed", help="slow, normal or fast.")]
Length = Annotated[float, typer.Argument(parser=parse_length_m, help="Metres, or like 120mm.")]
UncalibratedOption = Annotated[
    bool,
    typer.Option(
        "--uncalibrated", help="Trust the arm file's zeros, for an arm without a calibration."
    ),
]
NoWiggleOption = Annotated[
    bool,
    typer.Option("--no-wiggle", help="Skip the look at each joint after the arm's files changed."),
]
