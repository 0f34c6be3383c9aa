"""The touch-off as a pure state machine: readings and answers in, states out.

``touch -> review``. It knows no terminal, no bus and no clock, like the calibration by hand, so
a terminal, a page and a script drive the very same conversation. Every step returns a new one.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import repeat
from pathlib import Path

import numpy as np

from ikservo.calibration import JointMap
from ikservo.calibration.range_tracker import StillnessDetector
from ikservo.errors import BadValueError, CalibrationError, FileFormatError
from ikservo.files.reading import read_text
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Vector
from ikservo.model.kinematic_calibration import TouchPoint
from ikservo.model.model import Model
from ikservo.model.parameter_selection import MIN_TOUCHES, CalibrationEstimate, select_and_fit
from ikservo.model.tool import view_axes

__all__ = [
    "COLUMNS",
    "EDGE_M",
    "HIGH_M",
    "ROWS",
    "STEP_M",
    "TOUCH_ANSWERS",
    "WIDE_M",
    "ScriptedTouchAnswers",
    "TouchOffState",
    "TouchTarget",
    "apply_answer",
    "grid_points",
    "place_sheet",
    "read_touch_script",
]

WIDE_M, HIGH_M = 0.297, 0.210  # A4, its long edge before the arm
EDGE_M = 0.030  # from the near edge to the first row
STEP_M = 0.050
ROWS, COLUMNS = "1234", "ABCDE"  # rows away from the arm, columns from its left to its right

_MIN_DISTANCE_M = 0.05
_MIDDLE_M = EDGE_M + 0.5 * STEP_M * (len(ROWS) - 1)

_MOVED_TICKS = 20


@dataclass(frozen=True, slots=True, eq=False)
class TouchTarget:
    """A point that the tip shall be put on.

    Attributes:
        name: As on the sheet: ``B3``; ``B3 block`` on top of a block that stands there.
        position_m: Where it is (3,), metres, base frame; None where nobody has measured it.
    """

    name: str
    position_m: Vector | None = None


def grid_points() -> Iterator[tuple[str, float, float]]:
    """Yield each cross: name, metres from the near edge, metres left of the middle."""
    for i, row in enumerate(ROWS):
        for k, column in enumerate(COLUMNS):
            yield f"{column}{row}", EDGE_M + i * STEP_M, (2 - k) * STEP_M


def place_sheet(
    model: Model, edge_m: float | None, block_m: float | None
) -> tuple[float, list[TouchTarget]]:
    """Return the sheet as it lies before an arm.

    Args:
        model: The arm; straight ahead is where its tool is in the pose ``home``.
        edge_m: From the arm's base frame straight ahead to the near edge; None for where the
            middle of the sheet lies beneath that tool.
        block_m: How high a block is that the tip is put on at every other cross, if there is one.

    Returns:
        The distance of the near edge [m], and the places in the order in which to touch them.
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
        chain: The arm as described.
        present: The arm as it is believed at present.
        maps: What the ticks of each of the chain's joints mean.
        places: What is still to be touched, in order.
        touches: What has been touched.
        stillness: What was read in the last half second.
        ticks: By servo id, where the last touch was taken; empty before the first.
        found: What the touches say, once they are reviewed.
        before: The state before the person's last answer.
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

    @classmethod
    def begin(
        cls, chain: Chain, present: Chain, maps: Sequence[JointMap], places: Sequence[TouchTarget]
    ) -> TouchOffState:
        """Return a touch-off at its first point."""
        return cls(chain, present, tuple(maps), tuple(places))

    # --- what is so now ---

    @property
    def current_target(self) -> TouchTarget | None:
        """Return the point that the tip shall be put on next; None after the last."""
        return self.places[0] if self.places and self.found is None else None

    @property
    def is_at_rest(self) -> bool:
        """Return whether nothing has moved for half a second."""
        return self.stillness.is_at_rest()

    @property
    def has_moved(self) -> bool:
        """Return whether the arm has been moved since the last touch."""
        if not self.ticks or not self.stillness.readings:
            return True
        here = self.stillness.readings[-1][1].items()
        return any(abs(tick - self.ticks[servo_id]) > _MOVED_TICKS for servo_id, tick in here)

    # --- what can happen ---

    def update(self, at_s: float, ticks: Mapping[int, int]) -> TouchOffState:
        """Take a reading of the servos, ticks as reported by id, at a time [s]."""
        return replace(self, stillness=self.stillness.add_reading(at_s, ticks))

    def record_touch(self) -> TouchOffState:
        """Take where the arm is held for the point that is asked for.

        Raises:
            CalibrationError: The arm still moves, or nothing is asked for.
        """
        if self.current_target is None:
            raise CalibrationError("Every point has been touched.", "Evaluate (a), or undo (u).")
        if not self.is_at_rest:
            raise CalibrationError("The arm is still moving.", "Hold it still for half a second.")
        ticks = self.stillness.mean_ticks()
        touch = TouchPoint(
            self._joint_vector(ticks), self.current_target.name, self.current_target.position_m
        )
        return replace(
            self, touches=(*self.touches, touch), places=self.places[1:], ticks=ticks, before=self
        )

    def skip(self) -> TouchOffState:
        """Leave the point out that is asked for."""
        return replace(self, places=self.places[1:], before=self)

    def undo(self) -> TouchOffState:
        """Take the last answer back."""
        if self.before is None:
            return self
        return replace(self.before, stillness=self.stillness)

    def accept(self) -> TouchOffState:
        """End the touching and work out what it says.

        Raises:
            CalibrationError: There are too few touches, or they contradict each other.
        """
        return replace(
            self, found=select_and_fit(self.chain, self.touches, self.present), before=self
        )

    @property
    def has_enough_touches(self) -> bool:
        """Return whether the touches could be reviewed."""
        return len(self.touches) >= MIN_TOUCHES

    def _joint_vector(self, ticks: Mapping[int, float]) -> Vector:
        return np.array([joint.position(ticks[joint.servo_id]) for joint in self.maps])


TOUCH_ANSWERS = ("touch", "skip", "undo", "accept")

_MAX_SCRIPT_BYTES = 64 * 1024
_TIMEOUT_S = 60.0


def apply_answer(talk: TouchOffState, word: str) -> TouchOffState:
    """Return the conversation after an answer.

    Raises:
        BadValueError: It is no answer.
        CalibrationError: It cannot be said now; says why.
    """
    steps = {
        "touch": talk.record_touch,
        "skip": talk.skip,
        "undo": talk.undo,
        "accept": talk.accept,
    }
    if word not in steps:
        raise BadValueError("The answer", repr(word), f"one of: {', '.join(TOUCH_ANSWERS)}")
    return steps[word]()


def read_touch_script(path: Path) -> list[str]:
    """Return the answers in a file, one a line; ``#`` begins a remark.

    Raises:
        FileFormatError: The file cannot be read, or a line is no answer.
    """
    answers: list[str] = []
    for number, line in enumerate(read_text(path, _MAX_SCRIPT_BYTES).splitlines(), start=1):
        word = line.partition("#")[0].strip()
        if word and word not in TOUCH_ANSWERS:
            expected = f"one of: {', '.join(TOUCH_ANSWERS)}"
            raise FileFormatError(path, f"line {number}", "is not an answer", expected)
        answers += [word] if word else []
    return answers


class ScriptedTouchAnswers:
    """Gives answers one after the other, each when its moment has come.

    ``touch`` waits until the arm has been moved since the last one and is held still.

    Args:
        answers: In order; None to touch every point and accept.
    """

    def __init__(self, answers: Iterable[str] | None = None) -> None:
        self._patient = answers is None
        self._answers: Iterator[str] = repeat("") if answers is None else iter(answers)
        self._next = deque([next(self._answers, "accept")])
        self._since_s: float | None = None

    def next_answer(self, talk: TouchOffState, at_s: float) -> str | None:
        """Return the next answer if its moment has come.

        Raises:
            CalibrationError: It has not come for a minute.
        """
        self._since_s = at_s if self._since_s is None else self._since_s
        word = ("touch" if talk.current_target else "accept") if self._patient else self._next[0]
        if word != "touch" or talk.current_target is None or (talk.is_at_rest and talk.has_moved):
            self._next[0] = next(self._answers, "accept")
            self._since_s = at_s
            return word
        if at_s - self._since_s > _TIMEOUT_S:
            raise CalibrationError(
                f"Timeout: the tip was not put on {talk.current_target.name} within 60 s.",
                "Guide the tip there and keep it still.",
            )
        return None
