"""Convert results of a served arm to JSON and back; only listed dataclasses are allowed."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from typing import Annotated, Any, Optional, TypeVar, cast, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    JsonValue,
    PlainSerializer,
    ValidationError,
    create_model,
)

from ikservo.errors import IkservoError
from ikservo.planning.reports import (
    ArmState,
    FollowResult,
    GraspResult,
    JogResult,
    JointMoveResult,
    MotionProgress,
    MoveResult,
    ReplayResult,
)
from ikservo.serving.control_client import StopResult
from ikservo.serving.replies import other_version_error

RESULT_TYPES: Mapping[str, type] = {
    kind.__name__: kind
    for kind in (
        ArmState,
        FollowResult,
        GraspResult,
        JogResult,
        JointMoveResult,
        MotionProgress,
        MoveResult,
        ReplayResult,
        StopResult,
    )
}
"""Types that a service may return, by their name in a message."""

_KIND, _VALUE = "kind", "value"

T = TypeVar("T")


def _parse_array(value: object) -> NDArray[np.float64]:
    """Parse an array from nested lists; the only texts allowed are non-finite numbers."""
    try:
        return np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):  # OverflowError: an integer of 400 digits
        raise ValueError("expected numbers, or lists of them of equal length") from None


def _finite_or_text(value: object) -> object:
    if isinstance(value, list):
        return [_finite_or_text(each) for each in cast("list[object]", value)]
    if isinstance(value, float) and not np.isfinite(value):
        return str(value)  # JSON has no such numbers
    return value


FloatArray = Annotated[
    np.ndarray[Any, np.dtype[np.float64]],
    BeforeValidator(_parse_array),
    PlainSerializer(lambda value: _finite_or_text(value.tolist())),
]
"""An array in a message: lists of numbers, with ``nan`` and ``inf`` as text."""

_CONFIG = ConfigDict(extra="forbid", arbitrary_types_allowed=True, ser_json_inf_nan="strings")


@cache
def _schema_of(kind: type, left_out: frozenset[str]) -> type[BaseModel]:
    """Return the schema of a dataclass, with arrays as lists."""
    hints = get_type_hints(kind)
    fields: dict[str, Any] = {}
    for field in dataclasses.fields(kind):
        if field.init and field.name not in left_out:
            hint: Any = hints[field.name]
            if _is_array(hint):
                hint = FloatArray
            elif any(map(_is_array, get_args(hint))):  # Vector | None
                hint = Optional[FloatArray]  # noqa: UP045  # an annotated type has no operator
            fields[field.name] = (hint, ...)
    return create_model(kind.__name__, __config__=_CONFIG, **fields)


def _is_array(hint: object) -> bool:
    """Check whether an annotation means an array (in NumPy 2.5, an alias with its own origin)."""
    return get_origin(hint) in (np.ndarray, NDArray)


def encode_fields(value: Any, left_out: Iterable[str] = ()) -> dict[str, JsonValue]:  # noqa: ANN401
    """Encode a dataclass as JSON values by field; omit the fields in ``left_out``."""
    schema = _schema_of(type(value), frozenset(left_out))  # pyright: ignore[reportUnknownArgumentType]
    given = {name: getattr(value, name) for name in schema.model_fields}
    return schema.model_construct(**given).model_dump(mode="json")


def decode_fields(kind: type[T], fields: object, left_out: Mapping[str, object] | None = None) -> T:
    """Decode a dataclass from the result of ``encode_fields``.

    ``left_out`` contains the values of fields that were omitted.

    Raises:
        IkservoError: A field is missing, unknown, or of the wrong type.
    """
    more = left_out or {}
    schema = _schema_of(kind, frozenset(more))
    try:
        read = schema.model_validate(fields)
        return kind(**{name: getattr(read, name) for name in schema.model_fields}, **more)
    except (ValidationError, IkservoError):
        raise other_version_error() from None


def encode_value(value: object) -> JsonValue:
    """Encode a result as a JSON value; values of listed types get the name of the type.

    Raises:
        TypeError: A service may not return a value of this type.
    """
    name = type(value).__name__
    if RESULT_TYPES.get(name) is type(value):
        return {_KIND: name, _VALUE: encode_fields(value)}
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, list | tuple):
        return [encode_value(each) for each in cast("Sequence[object]", value)]
    if isinstance(value, Mapping):
        rows = cast("Mapping[str, object]", value)
        return {_KIND: "map", _VALUE: {name: encode_value(each) for name, each in rows.items()}}
    raise TypeError(f"no service returns {name}")


def decode_value(value: JsonValue) -> Any:  # noqa: ANN401
    """Decode a JSON value from ``encode_value``.

    Raises:
        IkservoError: The type is unknown, or a field is missing, unknown, or of the wrong type.
    """
    if isinstance(value, list):
        return [decode_value(each) for each in value]
    if not isinstance(value, dict):
        return value
    kind, inside = value.get(_KIND), value.get(_VALUE)
    if kind == "map" and isinstance(inside, dict):
        return {name: decode_value(each) for name, each in inside.items()}
    if not isinstance(kind, str) or kind not in RESULT_TYPES:
        raise other_version_error()
    return cast("object", decode_fields(RESULT_TYPES[kind], inside))


def decode_as(kind: type[T], value: JsonValue) -> T:
    """Decode a value of one type.

    Raises:
        IkservoError: The value has the wrong type.
    """
    found = decode_value(value)
    if not isinstance(found, kind):
        raise other_version_error()
    return found
