"""Surroundings of a simulated arm besides its table: cubes to grip, and the board of a camera."""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import MappingProxyType

from servosim.arm_file import SimulatedArmFile
from servosim.errors import SimulatorError

COLOURS = MappingProxyType(
    {
        "red": (0.80, 0.10, 0.08),
        "green": (0.10, 0.55, 0.15),
        "blue": (0.08, 0.20, 0.75),
        "yellow": (0.90, 0.75, 0.05),
    }
)
CUBE_HALF_M = 0.0175
_MAX_AWAY_M = 2.0


@dataclass(frozen=True, slots=True)
class Cube:
    """A wooden cube, which initially stands on the table.

    Attributes:
        colour: A key of ``COLOURS`` that no other cube has.
        x_m: Position of its middle, forward in the base frame.
        y_m: Position of its middle, to the left.
    """

    colour: str
    x_m: float
    y_m: float

    @property
    def name(self) -> str:
        """The name of the cube."""
        return f"{self.colour} cube"


@dataclass(frozen=True, slots=True)
class Surroundings:
    """The surroundings of an arm.

    Attributes:
        arm: The arm's file.
        cubes: Cubes on the table.
        has_board: Whether the board of a camera is on its tip.
    """

    arm: SimulatedArmFile
    cubes: tuple[Cube, ...] = ()
    has_board: bool = True


def parse_cubes(text: str) -> tuple[Cube, ...]:
    """Parse ``red@0.24,-0.06;blue@0.2,0.08``: colours, and places on the table in metres.

    Raises:
        SimulatorError: The text has another form, or a colour or a place cannot be used.
    """
    cubes: list[Cube] = []
    for part in filter(None, text.split(";")):
        colour, _, place = part.partition("@")
        try:
            x_m, y_m = (float(number) for number in place.split(","))
        except ValueError as error:
            raise SimulatorError(f"{part!r} is not a cube; try red@0.24,-0.06") from error
        if colour not in COLOURS:
            raise SimulatorError(f"no cube has the colour {colour!r}; known: {', '.join(COLOURS)}")
        if any(colour == other.colour for other in cubes):
            raise SimulatorError(f"there is only one {colour} cube")
        if not math.hypot(x_m, y_m) < _MAX_AWAY_M:  # also refuses NaN
            raise SimulatorError(f"the {colour} cube must be within {_MAX_AWAY_M:g} m of the base")
        cubes.append(Cube(colour, x_m, y_m))
    return tuple(cubes)
