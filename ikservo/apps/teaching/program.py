"""Programs: files of steps that an arm runs in order; users edit them by hand.

::

    format = 1
    arm = "so101"
    speed = "slow"          # of steps without a speed of their own; default: normal
    repeat = 2              # number of repetitions of all steps; default: 1

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

ACTIONS = ("pose", "tip_m", "joints", "gripper", "wait_s", "recording", "motion")
"""The actions of steps; each step has one. ``deg`` and ``m`` give ``joints``."""

MAX_STEPS = 1000
"""Largest number of steps in a program."""

_POINT = "[x, y, z] in metres"


def _parse_step_motion(value: object) -> MotionValue[Any]:
    motion = parse_motion(value)
    if "speed" in cast("Mapping[str, Any]", value)[motion.kind]:
        raise ValueError("has a speed, which belongs to the step")
    return motion


StepMotion = Annotated[
    MotionValue[Any], PlainValidator(_parse_step_motion), PlainSerializer(motion_fields)
]
Point = tuple[float, float, float]
Speed = Literal["slow", "normal", "fast"]
Label = Annotated[str, Field(min_length=1, max_length=80)]
_LABEL, _SPEED = "1 to 80 characters", "slow, normal or fast"


class ProgramStep(StrictModel):
    """One of the ``[[steps]]``: a motion, a motion of the gripper, or a wait."""

    name: Label | None = Field(default=None, description=_LABEL)
    pose: Label | None = Field(default=None, description="the name of a pose")
    tip_m: Point | None = Field(default=None, strict=False, description=_POINT)
    path: Literal["joints", "line", "arc"] | None = Field(
        default=None, description="joints, line or arc; only in a step with tip_m"
    )
    via_m: Point | None = Field(default=None, strict=False, description=f"{_POINT}; only in an arc")
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
        if self.action == "joints":
            moved = [f"{name} {value:g}°" for name, value in self.deg.items()]
            words = ", ".join(moved + [f"{name} {value:g} m" for name, value in self.m.items()])
        else:
            words = str(self._to_motion())
        return f"{self.name}: {words}" if self.name else words

    @property
    def has_speed(self) -> bool:
        """Whether the action has a speed class."""
        return self._to_motion().has_speed

    def to_motion(self, model: Model, speed: str) -> MotionValue[Any]:
        """Return the motion of the step.

        Args:
            model: The arm, which determines which joints are prismatic.
            speed: The speed class, for a motion that has one.

        Raises:
            BadValueError: A revolute joint is given in metres, or a prismatic one in degrees; or
                the motion refuses a value.
            UnknownNameError: There is no such joint.
        """
        for key, given in (("deg", self.deg), ("m", self.m)):
            for name in given:
                unit = model.joint(name).joint_map.unit
                if (unit == "m") != (key == "m"):
                    raise BadValueError(name, f"given by {key}", "m" if unit == "m" else "deg")
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
            raise ValueError(f"does {' and '.join(actions) or 'nothing'}")
        if actions != ["tip_m"] and (self.path or self.via_m):
            raise ValueError(f"has a path or via_m, but does {actions[0]}")
        if (self.path == "arc") != (self.via_m is not None):
            raise ValueError("needs both: path = arc, and via_m")
        if self.tool_speed_m_s is not None and self.path not in ("line", "arc"):
            raise ValueError("has tool_speed_m_s without a line or an arc")
        self._to_motion()  # raises if the motion refuses a value
        return self


class Program(StrictModel):
    """A program: the whole file."""

    format: Literal[1] = Field(description="1")
    arm: Name = Field(description="the arm's name")
    speed: Speed = Field(default="normal", description=_SPEED)
    repeat: Annotated[int, Field(ge=1, le=100_000)] = Field(
        default=1, description="a whole number from 1 to 100000"
    )
    steps: tuple[ProgramStep, ...] = Field(
        strict=False, min_length=1, max_length=MAX_STEPS, description="tables [[steps]]"
    )

    def speed_of(self, step: ProgramStep) -> str:
        """Return the speed class of a step."""
        return step.speed or self.speed


def read_program(path: Path | str) -> Program:
    """Read a program.

    Raises:
        FileFormatError: The program is malformed; the message names each step, from 1, and its key.
    """
    path = Path(path)
    return _checked_program(path, read_toml(path))


def parse_program(text: str) -> Program:
    """Parse the text of a program.

    Raises:
        FileFormatError: The text is malformed; the message names each step, from 1, and its key.
    """
    path = Path("the program")
    return _checked_program(path, parse_toml(path, text))


def _checked_program(path: Path, tables: Mapping[str, Any]) -> Program:
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
        FileWriteError: The file cannot be written; an older file is unchanged.
    """
    write_atomic(path, tomli_w.dumps(program.model_dump(exclude_defaults=True) | {"format": 1}))
