"""Messages between a served arm and its clients: JSON with schemas and limited sizes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Literal, TypeVar, cast

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, JsonValue, TypeAdapter, ValidationError

from ikservo.arm.result_json import RESULT_TYPES, FloatArray, decode_value, encode_value
from ikservo.errors import InputError
from ikservo.files.validation import first_mistake
from ikservo.ik import Target
from ikservo.serving.replies import SAME_VERSION, error_fields, other_version_error, result_in

SCHEMA = "ikservo/net/1"
MAX_REQUEST_BYTES = 1_000_000
MAX_REPLY_BYTES = 4_000_000
MAX_SETPOINT_BYTES = 4_096
"""Largest size of each kind of message, bytes; longer messages are refused unread."""

Lease = Annotated[str, Field(max_length=64, pattern=r"^[0-9a-f]*$")]
Number = Annotated[int, Field(ge=0, le=2**53)]
Seconds = Annotated[float, Field(ge=-1e12, le=1e12, allow_inf_nan=False)]
M = TypeVar("M", bound=BaseModel)
T = TypeVar("T")


class _NetworkMessage(BaseModel):
    model_config = ConfigDict(
        extra="forbid", arbitrary_types_allowed=True, ser_json_inf_nan="strings"
    )


class ServiceRequest(_NetworkMessage):
    """A request to the server of an arm; the service is in the key.

    Attributes:
        lease: The lease of control for the request; empty if none is needed.
        number: The number of this request under the lease, increasing; 0 without a lease.
        sent_s: Time of sending, by the clock of the server.
        stop_count: The number of stops of the arm when the motion was requested, perhaps long
            before sending; None: the number on arrival.
        arguments: The arguments of the service.
    """

    schema_: Literal["ikservo/net/1"] = Field(default=SCHEMA, alias="schema")
    lease: Lease = ""
    number: Number = 0
    sent_s: Seconds = 0.0
    stop_count: Number | None = None
    arguments: dict[str, JsonValue] = {}


class ServiceReply(_NetworkMessage):
    """The answer to a request: a result, or an error.

    Attributes:
        result: See ``encode_value``.
        error: The error if there is no result; see ``error_fields``.
    """

    schema_: Literal["ikservo/net/1"] = Field(default=SCHEMA, alias="schema")
    result: JsonValue = None
    error: dict[str, JsonValue] | None = None


class TargetFields(_NetworkMessage):
    """The fields of a ``Target`` in a stream."""

    position_m: FloatArray
    direction: FloatArray | None = None
    orientation: FloatArray | None = None
    frame: str | None = None
    offset_m: FloatArray | None = None
    tool_axis: FloatArray

    @classmethod
    def of(cls, target: Target) -> TargetFields:
        """Make the fields of a target."""
        return cls.model_validate({name: getattr(target, name) for name in cls.model_fields})

    def target(self) -> Target:
        """Return the target.

        Raises:
            BadValueError: A number is not finite, or a shape is wrong.
        """
        return Target(**dict(self))


class Setpoint(_NetworkMessage):
    """A heartbeat of the operator, with a goal if there is a new one.

    Attributes:
        lease: The operator's lease of control.
        number: The number of this message under the lease, increasing.
        sent_s: Time of sending, by the clock of the server.
        wanted: Whether a jog or the stream of goals continues; None if that has not changed.
        positions: The goal: joint positions by name, rad or m.
        pose: The goal as a pose of the tip, T_base_tip (4, 4), instead of joint positions.
        target: The goal as a target, instead of joint positions.
    """

    schema_: Literal["ikservo/net/1"] = Field(default=SCHEMA, alias="schema")
    lease: Lease
    number: Number
    sent_s: Seconds
    wanted: bool | None = None
    positions: dict[str, float] | None = None
    pose: FloatArray | None = None
    target: TargetFields | None = None


class Announcement(_NetworkMessage):
    """A message that a served arm publishes: states, progress, state of a stream.

    Attributes:
        number: A number that increases with each message.
        sent_s: Time of sending, by the clock of the server.
        value: See ``encode_value``.
    """

    schema_: Literal["ikservo/net/1"] = Field(default=SCHEMA, alias="schema")
    number: Number
    sent_s: Seconds
    value: JsonValue = None


class ServedHealth(BaseModel):
    """The result of the service ``health``: see ``ArmService.health``."""

    model_config = ConfigDict(extra="allow")  # newer versions may report more

    arm: str
    state: str
    operator: str
    stop_kind: str
    stop_text: str
    stop_requests: int
    temperature_c: float
    alarms: list[str]


class ServedPoses(BaseModel):
    """The result of the service ``poses``: the file, all poses, and those that were taught."""

    path: str
    all: dict[str, dict[str, float]]
    taught: dict[str, dict[str, float]]


class ClampedPose(BaseModel):
    """The result of the service ``within_limits``: positions, and the joints that were clamped."""

    positions: dict[str, float]
    changed: list[str]


class StreamCounts(BaseModel):
    """The result of the service ``stream``: see ``RemoteStream``."""

    unreached: int
    refused: int
    reason: str


class GrantedLease(BaseModel):
    """The result of the service ``lease``."""

    lease: Lease


def encode(message: BaseModel, max_bytes: int = MAX_REQUEST_BYTES) -> bytes:
    """Encode a message as JSON.

    Raises:
        InputError: The message is too long.
    """
    data = message.model_dump_json(by_alias=True, exclude_defaults=False).encode()
    if len(data) > max_bytes:
        text = f"A message of {len(data)} bytes is too long; {max_bytes} are allowed."
        raise InputError(text, "Send fewer points at once.")
    return data


def decode(kind: type[M], data: bytes, max_bytes: int) -> M:
    """Decode a message from JSON.

    Raises:
        InputError: The message is too long or of another kind.
    """
    if len(data) > max_bytes:
        raise InputError(f"A message is longer than {max_bytes} bytes.", "Nothing was done.")
    try:
        return kind.model_validate_json(data)
    except ValidationError as error:
        where, why = first_mistake(error)
        raise InputError(
            f"Not a valid message between ikservo programs: {where or 'the message'}: {why}.",
            f"Nothing was done. {SAME_VERSION}",
        ) from None


def encode_result(result: object) -> bytes:
    """Encode a reply with a result."""
    return encode(ServiceReply(result=encode_value(result)), MAX_REPLY_BYTES)


def encode_failure(error: BaseException) -> bytes:
    """Encode a reply with an error."""
    return encode(ServiceReply(error=error_fields(error)), MAX_REPLY_BYTES)


def result_of(data: bytes) -> object:
    """Return the result in a reply.

    Raises:
        IkservoError: The reply contains an error, or is not valid.
    """
    reply = decode(ServiceReply, data, MAX_REPLY_BYTES)
    return decode_value(cast("JsonValue", result_in(reply.model_dump())))


def parse_result(kind: type[T], result: object) -> T:
    """Return a decoded result after its type was checked, or plain values were converted to it.

    Raises:
        IkservoError: The result has the wrong type, so the other end runs a different version.
    """
    if kind in RESULT_TYPES.values():
        if not isinstance(result, kind):
            raise other_version_error()
        return result
    try:
        return TypeAdapter(kind).validate_python(result)
    except ValidationError:
        raise other_version_error() from None


def arguments_of(values: Mapping[str, object]) -> dict[str, JsonValue]:
    """Return the arguments of a service as JSON values, with arrays as lists.

    Raises:
        InputError: A value is not a number, text, list or mapping of these.
    """
    return {name: _as_json(name, value) for name, value in values.items()}


def _as_json(name: str, value: object) -> JsonValue:
    if isinstance(value, np.ndarray | np.generic):
        value = cast("object", value.tolist())
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else str(value)
    if isinstance(value, list | tuple):
        return [_as_json(name, each) for each in cast("Sequence[object]", value)]
    if isinstance(value, Mapping):
        rows = cast("Mapping[object, object]", value)
        return {str(key): _as_json(name, each) for key, each in rows.items()}
    raise InputError(f"{name} cannot be sent to another machine.", f"Found: {value!r}.")
