"""Touch-off as a pure state machine that maps readings and operator input to states.

``touch -> review``. It uses no terminal, no bus and no clock, like the calibration by hand, so
a terminal, a web page and a script use the same procedure. Every step returns a new state.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from ikservo.apps.calibrating.kinematic_calibration import TouchPoint
from ikservo.apps.calibrating.parameter_selection import (
    CalibrationEstimate,
    select_and_fit,
)
from ikservo.calibration import JointMap
from ikservo.control.stillness import StillnessDetector
from ikservo.errors import CalibrationError
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import FrozenArrays, Vector
from ikservo.model.arm_model import Model
from ikservo.model.tool import view_axes

WIDE_M, HIGH_M = 0.297, 0.210  # A4 with a long edge towards the arm
EDGE_M = 0.030  # distance from the near edge to the first row
STEP_M = 0.050
ROWS, COLUMNS = "1234", "ABCDE"  # rows count away from the arm, columns from left to right

_MIN_DISTANCE_M = 0.05
_MIDDLE_M = EDGE_M + 0.5 * STEP_M * (len(ROWS) - 1)

_MOVED_TICKS = 20


@dataclass(frozen=True, slots=True, eq=False)
class TouchTarget(FrozenArrays):
    """A point to touch with the tip.

    Attributes:
        name: The name on the sheet, such as ``B3``, or ``B3 block`` for the top of a block there.
        position_m: The position of the point (3,), metres, base frame; None if not measured.
    """

    name: str
    position_m: Vector | None = None


def grid_points() -> Iterator[tuple[str, float, float]]:
    """Yield the name of each cross, its distance from the near edge and left of the middle [m]."""
    for i, row in enumerate(ROWS):
        for k, column in enumerate(COLUMNS):
            yield f"{column}{row}", EDGE_M + i * STEP_M, (2 - k) * STEP_M


def place_sheet(
    model: Model, edge_m: float | None, block_m: float | None
) -> tuple[float, list[TouchTarget]]:
    """Compute the points of a sheet in front of an arm.

    Args:
        model: The arm; the direction of its tool in the pose ``home`` is straight ahead.
        edge_m: Distance straight ahead from the arm's base frame to the near edge; None puts the
            middle of the sheet beneath the tool.
        block_m: The height of a block that stands on every other cross; None without blocks.

    Returns:
        The distance of the near edge [m], and the targets in the order in which they are touched.
    """
    ahead, left, up = view_axes(model)
    reach_m = float(ahead @ model.chain.forward(model.chain_pose("home"))[:3, 3])
    nominal_m = max(_MIN_DISTANCE_M, math.floor((reach_m - _MIDDLE_M) * 100) / 100)
    edge_m = nominal_m if edge_m is None else edge_m
    floor: Vector = np.array([0.0, 0.0, model.floor_m or 0.0])
    places: list[TouchTarget] = []
    for i, (name, out_m, left_m) in enumerate(grid_points()):
        spot: Vector = floor + (edge_m + out_m) * ahead + left_m * left
        if block_m is None or i % 2 == 0:
            places.append(TouchTarget(name, spot))
        else:
            places.append(TouchTarget(f"{name} block", spot + block_m * up))
    return edge_m, places


@dataclass(frozen=True, slots=True, eq=False)
class TouchOffState:
    """The state of one touch-off.

    Attributes:
        chain: The arm as described by its file.
        present: The arm with its present calibration.
        maps: The conversion from ticks to positions for each joint of the chain.
        places: The remaining targets, in order.
        touches: The recorded touches.
        stillness: The readings of the last half second.
        ticks: The ticks of the last touch, by servo id; empty before the first.
        found: The estimate from the touches, once they are evaluated.
        before: The state before the last input.
    """

    chain: Chain
    present: Chain
    maps: tuple[JointMap, ...]
    places: tuple[TouchTarget, ...]
    touches: tuple[TouchPoint, ...] = ()
    stillness: StillnessDetector = field(default_factory=StillnessDetector)
    ticks: Mapping[int, float] = field(default_factory=dict[int, float])
    found: CalibrationEstimate | None = None
    before: TouchOffState | None = None

    # --- queries ---

    @property
    def current_target(self) -> TouchTarget | None:
        """The next target; None after the last."""
        return self.places[0] if self.places and self.found is None else None

    @property
    def is_at_rest(self) -> bool:
        """Whether nothing has moved for half a second."""
        return self.stillness.is_at_rest()

    @property
    def has_moved(self) -> bool:
        """Whether the arm has been moved since the last touch."""
        if not self.ticks or not self.stillness.readings:
            return True
        readings = self.stillness.readings[-1][1].items()
        return any(abs(tick - self.ticks[servo_id]) > _MOVED_TICKS for servo_id, tick in readings)

    # --- events ---

    def update(self, at_s: float, ticks: Mapping[int, int]) -> TouchOffState:
        """Add a reading of the servos at a time [s]: reported ticks by id."""
        return replace(self, stillness=self.stillness.add_reading(at_s, ticks))

    def record_touch(self) -> TouchOffState:
        """Record the arm's position as a touch of the current target.

        Raises:
            CalibrationError: The arm is still moving, or there is no target.
        """
        if self.current_target is None:
            raise CalibrationError("Every point has been touched.", "Evaluate (a), or undo (u).")
        if not self.is_at_rest:
            raise CalibrationError("The arm is still moving.", "Hold it still for half a second.")
        ticks = self.stillness.mean_ticks()
        q = np.array([joint.position(ticks[joint.servo_id]) for joint in self.maps])
        touch = TouchPoint(q, self.current_target.name, self.current_target.position_m)
        return replace(
            self, touches=(*self.touches, touch), places=self.places[1:], ticks=ticks, before=self
        )

    def skip(self) -> TouchOffState:
        """Skip the current target."""
        return replace(self, places=self.places[1:], before=self)

    def undo(self) -> TouchOffState:
        """Undo the last input."""
        if self.before is None:
            return self
        return replace(self.before, stillness=self.stillness)

    def accept(self) -> TouchOffState:
        """Evaluate the touches.

        Raises:
            CalibrationError: There are too few touches, or they contradict each other.
        """
        return replace(
            self, found=select_and_fit(self.chain, self.touches, self.present), before=self
        )
