"""Arguments of the planning tool: one field per kind of motion, with type and description."""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping
from dataclasses import MISSING, fields
from functools import cache
from types import NoneType
from typing import Annotated, Any, Literal, cast, get_args, get_type_hints

from pydantic import BaseModel, ConfigDict, Field, create_model

from ikservo.ik import Posture
from ikservo.planning.motions import KINDS, SPEEDS, MotionValue, parse_motion
from ikservo.planning.path_constraint import PathConstraint
from ikservo.planning.tool_orientation import ToolOrientation

MAX_POINTS = 300

Number = Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)]
Name = Annotated[str, Field(max_length=80)]
Point = Annotated[
    list[Number], Field(min_length=3, max_length=3, description="x, y, z; arm's base frame")
]
Points = Annotated[list[Point], Field(max_length=MAX_POINTS)]

_OWN_TYPES: Mapping[str, Any] = {
    "speed": Literal[SPEEDS],
    "points_m": Points,
    "strokes_m": Annotated[list[Points], Field(max_length=50)],
    "positions": Annotated[dict[Name, Number], Field(max_length=20)],
    "orientation": Annotated[list[Point], Field(min_length=3, max_length=3)],
    "to": Literal["open", "close"],
}
_LEFT_OUT = frozenset({"_", "posture", "replan"})
_PLAIN = {float: Number, bool: bool, str: Name, int: int}
_CONFIG = ConfigDict(extra="forbid")


class MotionArguments(BaseModel):
    """A motion; exactly one of its fields must be given."""

    model_config = _CONFIG

    def parse(self) -> MotionValue[Any]:
        """Return the motion.

        Raises:
            InputError: Not exactly one field is given, or a value is not valid for the motion.
        """
        return parse_motion(self.model_dump(exclude_none=True))


@cache
def motion_arguments() -> type[MotionArguments]:
    """Return `MotionArguments` with a field for each kind of motion of the core."""
    kinds: dict[str, Any] = {}
    for name, kind in KINDS.items():
        if name != "lower":  # a hot arm lowers itself; agents do not request it
            words = (kind.__doc__ or "").partition("\n")[0]
            kinds[name] = (_schema_of(kind) | None, Field(default=None, description=words))
    return create_model("Motion", __base__=MotionArguments, **kinds)


@cache
def _schema_of(kind: type[Any]) -> type[BaseModel]:
    """Return the fields of a dataclass as a schema with types, defaults and descriptions."""
    hints, texts = get_type_hints(kind), _attribute_texts(kind)
    schema: dict[str, Any] = {}
    for each in fields(kind):
        if each.name in _LEFT_OUT:
            continue
        required = each.default is MISSING
        hint = _type_of(each.name, hints[each.name])
        text = texts.get(each.name)
        schema[each.name] = (
            (hint, Field(description=text))
            if required
            else (hint | None, Field(default=None, description=text))
        )
    return create_model(kind.__name__, __config__=_CONFIG, **schema)


def _type_of(name: str, hint: Any) -> Any:  # noqa: ANN401  # an annotation is anything
    if name in _OWN_TYPES:
        return _OWN_TYPES[name]
    if hint in (ToolOrientation, PathConstraint, Posture):
        return _schema_of(hint)
    plain = [each for each in get_args(hint) or (hint,) if each is not NoneType]
    return _PLAIN[plain[0]] if len(plain) == 1 and plain[0] in _PLAIN else Point


def _attribute_texts(kind: type[Any]) -> dict[str, str]:
    """Return the descriptions of a dataclass's fields from its docstring."""
    section = inspect.cleandoc(kind.__doc__ or "").partition("Attributes:\n")[2]
    section = section.partition("\n\n")[0]
    found = re.findall(r"^    (\w+): (.*(?:\n {8}.*)*)", section, re.MULTILINE)
    return {name: " ".join(cast("str", text).split()) for name, text in found}
