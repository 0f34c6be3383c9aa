"""Programs: files of steps that an arm runs in order; users edit them by hand.

::

    format = 1
    arm = "so101"
    speed = "slow"          # of steps without a speed of their own; default: normal
    repeat = 2              # times that all steps are run; default: 1; or "until stopped"

    [[steps]]
    pose = "home"           # a pose of the arm file, or a taught one

    [[steps]]
    tip_m = [0.25, 0.05, 0.15]
    path = "line"           # joints (the default), line, or arc through via_m
    tool_speed_m_s = 0.05

    [[steps]]
    deg = { wrist_roll = 10.0 }         # joints that slide: m = { … }

    [[steps]]
    gripper = "close"       # open, close, or the distance between the jaws in metres

    [[steps]]
    wait_s = 0.5

    [[steps]]
    recording = "wave.jsonl"            # beside the program

    [[steps]]
    tip_m = [0.20, -0.05, 0.03]         # each repetition uses the next place of the grid
    grid = { rows = 2, columns = 3, row_m = [0.0, 0.04, 0.0], column_m = [0.04, 0.0, 0.0] }
    only_if = "grasped"                 # or "not grasped": what the gripper found last

    [[steps]]
    program = "stack.toml"              # all steps of another program, beside this one

    [[steps]]
    pause = "Put in the next part."     # until a person continues

    [[steps]]                           # any motion of `ikservo.planning.motions`, with its fields
    motion.move_through = { points_m = [[0.25, 0.0, 0.1], [0.25, 0.05, 0.15]], blend_m = 0.03 }
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self, cast

import tomli_w
from pydantic import Field, PlainSerializer, PlainValidator, ValidationError, model_validator

from ikservo.apps.teaching.replaying import Replay
from ikservo.errors import BadValueError, FileFormatError
from ikservo.files.reading import parse_toml, read_toml
from ikservo.files.validation import StrictModel, format_key_path, validation_issues
from ikservo.files.writing import write_atomic
from ikservo.model import Model
from ikservo.model.arm_schema import Name
from ikservo.planning.motions import (
    MotionValue,
    MoveArc,
    MoveGripper,
    MoveJoints,
    MoveLine,
    MovePose,
    MoveTo,
    Wait,
    motion_fields,
    motion_names,
    parse_motion,
)

ACTIONS = (
    "pose", "tip_m", "joints", "gripper", "wait_s", "recording", "program", "pause", "motion"
)  # fmt: skip
"""The actions of steps; each step has one. ``deg`` and ``m`` give ``joints``."""

MAX_STEPS = 1000
"""Largest number of steps in a program."""

_POINT = "[x, y, z] in metres"


def _parse_step_motion(value: object) -> MotionValue[Any]:
    motion = parse_motion(value)
    if "speed" in cast("Mapping[str, Any]", value)[motion.kind]:
        raise ValueError("has a speed, which must be given in the step")
    return motion


StepMotion = Annotated[
    MotionValue[Any], PlainValidator(_parse_step_motion), PlainSerializer(motion_fields)
]
Point = tuple[float, float, float]
Speed = Literal["slow", "normal", "fast"]
Label = Annotated[str, Field(min_length=1, max_length=80)]
_LABEL, _SPEED = "1 to 80 characters", "slow, normal or fast"
Repeat = Annotated[int, Field(ge=1, le=100_000)] | Literal["until stopped"]
UNTIL_STOPPED = "until stopped"
"""Value of ``repeat`` for a program that is repeated until it is stopped."""


class Grid(StrictModel):
    """The key ``grid``: places in rows and columns; each repetition uses the next place."""

    rows: Annotated[int, Field(ge=1, le=30)] = Field(description="a whole number from 1 to 30")
    columns: Annotated[int, Field(ge=1, le=30)] = Field(description="a whole number from 1 to 30")
    row_m: Point = Field(default=(0.0, 0.0, 0.0), strict=False, description=_POINT)
    column_m: Point = Field(default=(0.0, 0.0, 0.0), strict=False, description=_POINT)

    def place_m(self, first_m: Point, repetition: int) -> Point:
        """Return the place of a repetition, counted from 1; the first place is ``first_m``."""
        row, column = divmod((repetition - 1) % (self.rows * self.columns), self.columns)
        x, y, z = (
            at + row * down + column * across
            for at, down, across in zip(first_m, self.row_m, self.column_m, strict=True)
        )
        return x, y, z

    def distance_m(
        self, key: Literal["row_m", "column_m"], first_m: Point, corner_m: Point
    ) -> Point:
        """Return the row or column spacing that puts the last one at ``corner_m``."""
        count = max((self.rows if key == "row_m" else self.columns) - 1, 1)
        x, y, z = (round((b - a) / count, 6) + 0.0 for a, b in zip(first_m, corner_m, strict=True))
        return x, y, z


class ProgramStep(StrictModel):
    """One of the ``[[steps]]``, such as a motion, a motion of the gripper, or a wait."""

    name: Label | None = Field(default=None, description=_LABEL)
    pose: Label | None = Field(default=None, description="the name of a pose")
    tip_m: Point | None = Field(default=None, strict=False, description=_POINT)
    path: Literal["joints", "line", "arc"] | None = Field(
        default=None, description="joints, line or arc; only in a step with tip_m"
    )
    via_m: Point | None = Field(default=None, strict=False, description=f"{_POINT}; only in an arc")
    grid: Grid | None = Field(
        default=None,
        description="rows and columns from 1 to 30, row_m, column_m; only with tip_m",
    )
    deg: Mapping[Name, float] = Field(default={}, description="joint = degrees")
    m: Mapping[Name, float] = Field(default={}, description="joint = metres")
    gripper: Literal["open", "close"] | float | None = Field(
        default=None, description="open, close, or a width in metres"
    )
    wait_s: Annotated[float, Field(gt=0, le=3600)] | None = Field(
        default=None, description="seconds, above 0 and at most 3600"
    )
    recording: Label | None = Field(
        default=None, description="a file, relative to the program file"
    )
    program: Label | None = Field(default=None, description="a file, relative to the program file")
    pause: Label | None = Field(default=None, description="what a person does before continuing")
    only_if: Literal["grasped", "not grasped"] | None = Field(
        default=None, description="grasped or not grasped"
    )
    speed: Speed | None = Field(default=None, description=_SPEED)
    tool_speed_m_s: Annotated[float, Field(gt=0, le=10)] | None = Field(
        default=None, description="m/s, for a line or an arc"
    )
    motion: StepMotion | None = Field(
        default=None, description=f"the fields of one of {', '.join(motion_names())}"
    )

    @property
    def action(self) -> str:
        """Action of the step, one of ``ACTIONS``."""
        return self._actions()[0]

    @property
    def description(self) -> str:
        """Description of the step, in a few words."""
        if self.pause is not None:
            words = f"pause: {self.pause}"
        elif self.program is not None:
            words = f"program {self.program}"
        elif self.action == "joints":
            moved = [f"{name} {value:g}°" for name, value in self.deg.items()]
            words = ", ".join(moved + [f"{name} {value:g} m" for name, value in self.m.items()])
        else:
            words = str(self._to_motion())
        words = f"if {self.only_if}, {words}" if self.only_if else words
        return f"{self.name}: {words}" if self.name else words

    @property
    def has_speed(self) -> bool:
        """Whether the action has a speed class."""
        return self.has_motion and self._to_motion().has_speed

    @property
    def has_motion(self) -> bool:
        """Whether the step is one motion or a wait, and not a pause or another program."""
        return self.pause is None and self.program is None

    def at_repetition(self, repetition: int) -> ProgramStep:
        """Return the step for a repetition of the program, with the place from its grid."""
        if self.grid is None or self.tip_m is None:
            return self
        return self.model_copy(update={"tip_m": self.grid.place_m(self.tip_m, repetition)})

    def to_motion(self, model: Model, speed: str) -> MotionValue[Any]:
        """Return the motion of the step; ``speed`` is the speed class, if the motion has one.

        Raises:
            BadValueError: A revolute joint is given in metres, or a prismatic one in degrees; or
                the motion refuses a value.
            UnknownNameError: There is no such joint.
        """
        for key, given in (("deg", self.deg), ("m", self.m)):
            for name in given:
                unit = model.joint(name).joint_map.unit
                if (unit == "m") != (key == "m"):
                    raise BadValueError(name, f"given in {key}", "m" if unit == "m" else "deg")
        return self._to_motion().with_speed(speed)

    def _to_motion(self) -> MotionValue[Any]:
        match self.action:
            case "pose":
                return MovePose(self.pose or "")
            case "tip_m" if self.path == "arc":
                return MoveArc(self.via_m, self.tip_m, tool_speed_m_s=self.tool_speed_m_s)
            case "tip_m" if self.path == "line":
                return MoveLine(self.tip_m or (), tool_speed_m_s=self.tool_speed_m_s)
            case "tip_m":
                return MoveTo(self.tip_m or ())
            case "joints":
                turned = {name: math.radians(value) for name, value in self.deg.items()}
                return MoveJoints(turned | dict(self.m))
            case "gripper":
                to = self.gripper
                return MoveGripper(to) if isinstance(to, str) else MoveGripper(width_m=to)
            case "wait_s":
                return Wait(self.wait_s or 0.0)
            case "recording":
                return Replay(self.recording or "")
            case _:
                return cast("MotionValue[Any]", self.motion)

    def _actions(self) -> list[str]:
        given = {name: getattr(self, name, None) is not None for name in ACTIONS}
        given["joints"] = bool(self.deg or self.m)
        return [name for name in ACTIONS if given[name]]

    @model_validator(mode="after")
    def _check_keys(self) -> Self:
        """Refuse a step without exactly one action, or with options of another action."""
        actions = self._actions()
        if len(actions) != 1:
            raise ValueError(f"needs one action, but has {' and '.join(actions) or 'none'}")
        if actions != ["tip_m"] and (self.path or self.via_m or self.grid):
            raise ValueError(f"has a path, via_m or a grid, which {actions[0]} cannot have")
        if self.grid and self.via_m:
            raise ValueError("has a grid, which an arc cannot have")
        if (self.path == "arc") != (self.via_m is not None):
            raise ValueError("needs both path = arc and via_m")
        if self.tool_speed_m_s is not None and self.path not in ("line", "arc"):
            raise ValueError("has tool_speed_m_s without a line or an arc")
        if self.has_motion:
            self._to_motion()  # raises if the motion refuses a value
        elif self.speed is not None:
            raise ValueError(f"has a speed, which {actions[0]} cannot have")
        return self


class Program(StrictModel):
    """The content of a program file."""

    format: Literal[1] = Field(description="1")
    arm: Name = Field(description="the arm's name")
    speed: Speed = Field(default="normal", description=_SPEED)
    repeat: Repeat = Field(
        default=1, description="a whole number from 1 to 100000, or until stopped"
    )
    steps: tuple[ProgramStep, ...] = Field(
        strict=False, min_length=1, max_length=MAX_STEPS, description="tables [[steps]]"
    )

    def speed_of(self, step: ProgramStep) -> str:
        """Return the speed class of a step."""
        return step.speed or self.speed

    @property
    def repetitions(self) -> float:
        """Number of repetitions; infinite until it is stopped."""
        return math.inf if self.repeat == UNTIL_STOPPED else float(self.repeat)

    @property
    def is_sequence(self) -> bool:
        """Whether the steps are fixed motions: no condition, grid, pause, or other program."""
        steps = self.steps
        plain = all(s.has_motion and s.only_if is None and s.grid is None for s in steps)
        return plain and self.repeat != UNTIL_STOPPED


def read_program(path: Path | str) -> Program:
    """Read a program.

    Raises:
        FileFormatError: The program is malformed; the message names each step, from 1, and its key.
    """
    path = Path(path)
    return check_program(path, read_toml(path))


def parse_program(text: str) -> Program:
    """Parse the text of a program.

    Raises:
        FileFormatError: The text is malformed; the message names each step, from 1, and its key.
    """
    path = Path("the program")
    return check_program(path, parse_toml(path, text))


def check_program(path: Path, tables: Mapping[str, Any]) -> Program:
    """Return the program of tables; ``path`` names it in the error.

    Raises:
        FileFormatError: The program is malformed; the message names each step, from 1, and its key.
    """
    try:
        return Program.model_validate(tables)
    except ValidationError as error:
        raise _format_error(path, error) from None


_SHOWN_ISSUES = 10


def _format_error(path: Path, error: ValidationError) -> FileFormatError:
    """Format all mistakes of a program as one error, one mistake per line and each once."""
    lines: list[str] = []
    issues = validation_issues(error, Program)
    places = [issue.location for issue in issues]
    for issue in issues:
        if any(p[: len(issue.location)] == issue.location != p for p in places):
            continue  # the error of the value is reported instead
        location, where = issue.location, ""
        if location[:1] == ("steps",) and len(location) > 1:
            # Steps are counted from 1, as in the output of a run.
            where = f"step {int(location[1]) + 1}{', ' if location[2:] else ''}"
            location = location[2:]
        where += format_key_path(location)
        expected = f"; expected {issue.expected}" if issue.expected else ""
        lines.append(f"{where}: {issue.found}{expected}")
    lines = list(dict.fromkeys(lines))
    more = len(lines) - _SHOWN_ISSUES
    shown = lines[:_SHOWN_ISSUES] + ([f"and {more} more"] if more > 0 else [])
    where, _, first = shown[0].partition(": ")
    found = "\n".join([first, *shown[1:]])
    return FileFormatError(path, where, found, "")


def write_program(path: Path, program: Program) -> None:
    """Write a program as a file.

    Raises:
        FileWriteError: The file cannot be written; an existing file is unchanged.
    """
    write_atomic(path, tomli_w.dumps(program.model_dump(exclude_defaults=True) | {"format": 1}))
