"""Addresses of arms on other machines, and the endpoints at which they are served."""

from __future__ import annotations

import ipaddress
import re
import socket
from dataclasses import dataclass
from typing import Literal

from ikservo.errors import BadValueError, InputError, shown

SCHEME = "zenoh"
DEFAULT_PORT = 7448
"""The default port; it differs from 7447, which the Zenoh router of ROS 2 uses."""

_NAME = re.compile(r"[A-Za-z0-9_-]{1,64}")
_EXPECTED_NAME = "1 to 64 of the characters A-Z a-z 0-9 _ -"
_EXPECTED = "zenoh:NAME@HOST or zenoh:NAME@HOST:PORT, as in zenoh:desk@lab-pi"
_EXPECTED_ENDPOINT = "tcp/127.0.0.1:7448, or tls/0.0.0.0:7448 with certificates"
_HOST = re.compile(r"[A-Za-z0-9]([A-Za-z0-9.-]{0,251}[A-Za-z0-9])?")

_PROBE_TIMEOUT_S = 0.3

Protocol = Literal["tcp", "tls"]


@dataclass(frozen=True, slots=True)
class Endpoint:
    """The endpoint at which a process listens or to which it connects.

    Attributes:
        protocol: ``tcp`` for this machine only, or ``tls`` with certificates.
        host: A name or an address.
        port: The TCP port.
    """

    protocol: Protocol
    host: str
    port: int

    def __str__(self) -> str:
        """Return the endpoint in Zenoh's notation: ``tls/lab-pi:7448``."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.protocol}/{host}:{self.port}"

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine can reach the endpoint."""
        return _is_loopback(self.host)


@dataclass(frozen=True, slots=True)
class ArmAddress:
    """The name under which an arm is served, and the endpoint."""

    name: str
    endpoint: Endpoint

    def __str__(self) -> str:
        """Return the address as a user writes it for ``--port``."""
        protocol = "tcp" if self.endpoint.is_loopback else "tls"
        place = str(self.endpoint)
        if protocol == self.endpoint.protocol:
            place = place.partition("/")[2]
        return f"{SCHEME}:{self.name}@{place.removesuffix(f':{DEFAULT_PORT}')}"

    def from_other_machines(self) -> ArmAddress:
        """Return the address, with this machine's name if the endpoint is a wildcard."""
        import platform  # noqa: PLC0415  # rarely needed

        endpoint = self.endpoint
        if endpoint.host not in ("0.0.0.0", "::"):  # noqa: S104
            return self
        return ArmAddress(self.name, Endpoint(endpoint.protocol, platform.node(), endpoint.port))


def listens(endpoint: Endpoint) -> bool:
    """Check whether a process listens at an endpoint, because Zenoh sessions take long to fail."""
    try:
        socket.create_connection((endpoint.host, endpoint.port), _PROBE_TIMEOUT_S).close()
    except OSError:
        return False
    return True


def check_arm_name(name: str) -> str:
    """Check the name under which an arm will be served.

    Raises:
        BadValueError: The name is empty, too long, or has a forbidden character.
    """
    if not _NAME.fullmatch(name):
        raise BadValueError("The name of the served arm", shown(name), _EXPECTED_NAME)
    return name


def check_host(host: str) -> str:
    """Check the name or address of a machine.

    Raises:
        BadValueError: The text is not valid.
    """
    if not (_is_ip(host) or _HOST.fullmatch(host)):
        raise BadValueError("The host", shown(host), "a name or an address, such as lab-pi")
    return host


def parse_address(text: str) -> ArmAddress:
    """Parse the address in ``zenoh:NAME@HOST[:PORT]``.

    This machine is reached without certificates, other machines with them, unless ``tls/`` or
    ``tcp/`` precedes the host.

    Raises:
        BadValueError: The text is not an address; the message names the wrong part.
    """
    scheme, colon, rest = text.partition(":")
    name, at, place = rest.rpartition("@")
    if scheme != SCHEME or not colon or not at:
        raise BadValueError("The address of the arm", shown(text), _EXPECTED)
    return ArmAddress(check_arm_name(name), parse_host(place))


def parse_host(text: str) -> Endpoint:
    """Parse the endpoint of a connection in ``[tls/|tcp/]HOST[:PORT]``.

    Raises:
        BadValueError: The endpoint is not valid.
    """
    protocol, slash, place = text.rpartition("/")
    host, port = _split_place(place, text, _EXPECTED)
    if not slash:
        protocol = "tcp" if _is_loopback(host) else "tls"
    return Endpoint(_check_protocol(protocol, text), host, port)


def parse_listen(text: str) -> Endpoint:
    """Parse the endpoint at which an arm will be served.

    Raises:
        BadValueError: The endpoint is not valid.
        InputError: Other machines could reach it without certificates.
    """
    protocol, slash, place = text.rpartition("/")
    if not slash:
        raise BadValueError("The endpoint", shown(text), _EXPECTED_ENDPOINT)
    host, port = _split_place(place, text, _EXPECTED_ENDPOINT)
    endpoint = Endpoint(_check_protocol(protocol, text), host, port)
    if endpoint.protocol == "tcp" and not endpoint.is_loopback:
        raise InputError(
            f"Without certificates, an arm can be served only to this machine, not at {text}.",
            f"Make certificates: ikservo net keys. Then serve the arm at tls/{place}.",
        )
    return endpoint


def _check_protocol(protocol: str, text: str) -> Protocol:
    if protocol not in ("tcp", "tls"):
        raise BadValueError("The endpoint", shown(text), _EXPECTED_ENDPOINT)
    return protocol


def _split_place(place: str, text: str, expected: str) -> tuple[str, int]:
    """Split ``HOST``, ``HOST:PORT`` or ``[IPv6]:PORT`` into host and port."""
    found = re.fullmatch(r"(?:\[([0-9a-fA-F:.]+)\]|([^:\[\]]+))(?::(\d{1,5}))?", place)
    if found is None:
        raise BadValueError("The address", shown(text), expected)
    host, port = found[1] or found[2], int(found[3] or DEFAULT_PORT)
    if not 0 < port <= 65535 or not (_is_ip(host) or _HOST.fullmatch(host)):
        raise BadValueError("The address", shown(text), expected)
    return host, port


def _is_ip(host: str) -> bool:
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True


def _is_loopback(host: str) -> bool:
    return host == "localhost" or (_is_ip(host) and ipaddress.ip_address(host).is_loopback)
