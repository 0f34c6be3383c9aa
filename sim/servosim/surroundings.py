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
_MIN_EDGE_M, _MAX_EDGE_M = 0.005, 0.2


@dataclass(frozen=True, slots=True)
class Cube:
    """A wooden cube, which initially stands on the table.

    Attributes:
        colour: A key of ``COLOURS`` that no other cube has.
        x_m: Position of its middle, forward in the base frame.
        y_m: Position of its middle, to the left.
        half_m: Half the length of its edges.
    """

    colour: str
    x_m: float
    y_m: float
    half_m: float = CUBE_HALF_M

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
    """Parse ``red@0.24,-0.06;blue@0.2,0.08,0.05``: colours, places on the table, edges; metres.

    A cube without an edge has the usual one, 0.035.

    Raises:
        SimulatorError: The text has another form, or a colour or a place cannot be used.
    """
    cubes: list[Cube] = []
    for part in filter(None, text.split(";")):
        colour, _, place = part.partition("@")
        try:
            x_m, y_m, *edge = (float(number) for number in place.split(","))
            (half_m,) = (each / 2.0 for each in edge or [2.0 * CUBE_HALF_M])
        except ValueError as error:
            raise SimulatorError(f"{part!r} is not a cube; try red@0.24,-0.06") from error
        if colour not in COLOURS:
            raise SimulatorError(f"no cube has the colour {colour!r}; known: {', '.join(COLOURS)}")
        if any(colour == other.colour for other in cubes):
            raise SimulatorError(f"there is only one {colour} cube")
        if not math.hypot(x_m, y_m) < _MAX_AWAY_M:  # also refuses NaN
            raise SimulatorError(f"the {colour} cube must be within {_MAX_AWAY_M:g} m of the base")
        if not _MIN_EDGE_M <= 2.0 * half_m <= _MAX_EDGE_M:  # also refuses NaN
            limits = f"{_MIN_EDGE_M:g} to {_MAX_EDGE_M:g} m"
            raise SimulatorError(f"the edges of the {colour} cube must be {limits} long")
        cubes.append(Cube(colour, x_m, y_m, half_m))
    return tuple(cubes)
