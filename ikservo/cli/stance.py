"""How the tool shall stand, as options that commands share."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from ikservo.cli.quantities import parse_angle_rad, parse_axis

if TYPE_CHECKING:
    from ikservo.arm.planning import Stance

__all__ = ["DirectionOption", "KeepOption", "PitchOption", "RollOption", "stance_of"]

PitchOption = Annotated[
    float | None,
    typer.Option(
        "--pitch",
        parser=parse_angle_rad,
        metavar="DEG",
        help="How steep the tool stands: 0 level, -90 straight down.",
    ),
]
RollOption = Annotated[
    float | None,
    typer.Option(
        "--roll",
        parser=parse_angle_rad,
        metavar="DEG",
        help="How far it is turned about its axis, clockwise from behind; 0 level.",
    ),
]
DirectionOption = Annotated[
    str | None, typer.Option("--direction", metavar="X,Y,Z", help="Where the tool shall point.")
]
KeepOption = Annotated[
    bool, typer.Option("--keep", help="Keep the whole orientation of the tool, or do not move.")
]


def stance_of(
    pitch_rad: float | None, roll_rad: float | None, direction: str | None, *, keep: bool
) -> Stance:
    """Return the stance that the options ask for.

    Raises:
        BadValueError: They contradict each other, or an angle is too large.
    """
    from ikservo.arm.planning import Stance  # noqa: PLC0415  # brings the servos' rooms along

    axis = None if direction is None else parse_axis(direction)
    return Stance(pitch_rad, roll_rad, axis, keep)
