"""ROS 2 messages: types, encoding as CDR, and hashes of their definitions."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

from ikservo.errors import IkservoError, InputError
from ikservo.remedies import install_command
from ikservo.ros_messages.service_types import EVENT_INFO, TRIGGER, service_types

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

__all__ = ["TRIGGER", "decode", "definition", "encode", "make", "type_hash"]


_HEADER_BYTES = 4


@cache
def _store() -> Typestore:
    try:
        from rosbags.interfaces import Nodetype  # noqa: PLC0415  # an extra
        from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415
    except ImportError:
        raise IkservoError(
            "ROS 2 messages need the package rosbags, which is not installed.",
            f"Install it: {install_command('record')}",
        ) from None
    store = get_typestore(Stores.ROS2_JAZZY)
    # rosbags hashes an array of char as such; ROS 2 treats char in a definition as uint8.
    del store.fielddefs[EVENT_INFO]
    store.register(service_types(Nodetype))
    return store


def make(kind: str, **fields: Any) -> Any:  # noqa: ANN401  # classes that rosbags generates
    """Make a message of a type such as ``sensor_msgs/msg/JointState``.

    Raises:
        IkservoError: rosbags is not installed.
    """
    return _store().types[kind](**fields)


def encode(kind: str, message: object) -> bytes:
    """Encode a message as CDR, little endian, with its header of 4 bytes."""
    return bytes(_store().serialize_cdr(message, kind))


def decode(kind: str, data: bytes) -> Any:  # noqa: ANN401
    """Decode a message from CDR.

    Bytes after the last field are ignored, because ROS 2's ``serialize_message`` may append up to
    16 bytes per point of a trajectory.

    Raises:
        InputError: The data is not a message of that type.
    """
    store = _store()
    layout = store.get_msgdef(kind)
    decoders = {b"\x00\x00": layout.deserialize_cdr_be, b"\x00\x01": layout.deserialize_cdr_le}
    try:
        message, size = decoders[data[:2]](data[_HEADER_BYTES:], 0, layout.cls, store)
        if size + _HEADER_BYTES > len(data):
            raise ValueError("it is shorter than its fields")
    except Exception as error:  # any error of the generated code
        raise InputError(f"Not a message of type {kind}: {error}.", "Nothing was done.") from None
    return message


@cache
def definition(kind: str) -> str:
    """Return the definition of a message with all referenced definitions, as in recordings."""
    return _store().generate_msgdef(kind, ros_version=2)[0]


@cache
def type_hash(kind: str) -> str:
    """Return the hash of a type according to REP 2016: ``RIHS01_`` and 64 hexadecimal digits."""
    return _store().hash_rihs01(kind)
