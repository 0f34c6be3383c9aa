"""The wire format of rmw_zenoh: key expressions, liveliness tokens, attachments.

Source: the design of rmw_zenoh, https://github.com/ros2/rmw_zenoh/blob/rolling/docs/design.md
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from enum import Enum

from ikservo.errors import BadValueError, InputError, shown
from ikservo.ros_messages.message_types import type_hash

MAX_DOMAIN = 232
"""The highest ROS 2 domain."""

_GID_BYTES = 16
_ATTACHMENT = struct.Struct(f"<qqB{_GID_BYTES}s")
_NAMESPACE = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")
_USUAL_QOS, _LATCHED_QOS = "::,10:,:,:,,", ":1:,1:,:,:,,"


class EndpointKind(Enum):
    """The kinds of endpoints that a liveliness token announces."""

    PUBLISHER = "MP"
    SUBSCRIPTION = "MS"
    SERVICE = "SS"


@dataclass(frozen=True, slots=True)
class Attachment:
    """The attachment of every message, request and response.

    Attributes:
        sequence: Number of the message, counted per sender.
        time_ns: The time of sending, nanoseconds since 1970.
        gid: The id of the sender, 16 bytes.
    """

    sequence: int
    time_ns: int
    gid: bytes

    def to_bytes(self) -> bytes:
        """Pack the attachment into 33 bytes."""
        return _ATTACHMENT.pack(self.sequence, self.time_ns, _GID_BYTES, self.gid)

    @classmethod
    def from_bytes(cls, data: bytes) -> Attachment:
        """Parse an attachment.

        Raises:
            InputError: The data is not an attachment.
        """
        if len(data) != _ATTACHMENT.size or data[_ATTACHMENT.size - _GID_BYTES - 1] != _GID_BYTES:
            hint = "Use ROS 2 Jazzy or later on the other machine."
            raise InputError("A message lacks the attachment of rmw_zenoh.", hint)
        sequence, time_ns, _, gid = _ATTACHMENT.unpack(data)
        return cls(sequence, time_ns, gid)


@dataclass(frozen=True, slots=True)
class NodeName:
    """The name of a node in the graph.

    Attributes:
        domain: The domain of ROS 2.
        session: The id of the node's Zenoh session.
        namespace: The namespace with a leading slash; empty for none.
        name: The name of the node.
    """

    domain: int
    session: str
    namespace: str
    name: str

    def full_name(self, name: str) -> str:
        """Return a name with a leading slash, inside the namespace."""
        return f"{self.namespace}{name}"


def check_namespace(namespace: str) -> str:
    """Check a namespace and return it with a leading slash; empty for none.

    Raises:
        BadValueError: ROS 2 does not allow the name.
    """
    slashed = "/" + namespace.strip("/")
    if slashed == "/":
        return ""
    if not _NAMESPACE.fullmatch(slashed):
        raise BadValueError(
            "The namespace", shown(namespace), "a name of letters, digits and _, such as left"
        )
    return slashed


def data_key(node: NodeName, name: str, kind: str) -> str:
    """Return the key expression for the messages on a topic or the requests to a service."""
    full = node.full_name(name).lstrip("/")
    return f"{node.domain}/{full}/{_dds_type(kind)}/{type_hash(kind)}"


def node_token(node: NodeName) -> str:
    """Return the liveliness token of a node."""
    return f"{_token_start(node, 0)}/NN/{_node_part(node)}"


def endpoint_token(
    node: NodeName, number: int, endpoint: EndpointKind, name: str, kind: str, *, latched: bool
) -> str:
    """Return the liveliness token of a publisher, a subscription or a service."""
    qos = _LATCHED_QOS if latched else _USUAL_QOS
    full = _mangle(node.full_name(name))
    start = f"{_token_start(node, number)}/{endpoint.value}/{_node_part(node)}"
    return f"{start}/{full}/{_dds_type(kind)}/{type_hash(kind)}/{qos}"


def _token_start(node: NodeName, number: int) -> str:
    return f"@ros2_lv/{node.domain}/{node.session}/0/{number}"


def _node_part(node: NodeName) -> str:
    return f"%/{_mangle(node.namespace)}/{node.name}"


def _mangle(name: str) -> str:
    return name.replace("/", "%") or "%"


def _dds_type(kind: str) -> str:
    package, group, name = kind.split("/")
    return f"{package}::{group}::dds_::{name}_"
