"""Stop arms on other machines, whoever controls them, until they confirm the stop.

``ikservo stop`` imports this module, so it imports nothing large except Zenoh: see
``control_client``.
"""

from __future__ import annotations

import contextlib
import json
import os
import time
from typing import TYPE_CHECKING, Any, cast

from ikservo.apps.remote import key_expressions as keys
from ikservo.apps.remote.address import Endpoint, listens, parse_address, parse_host
from ikservo.apps.remote.certificates import client_certificate
from ikservo.apps.remote.zenoh_session import (
    Certificate,
    ask,
    on_each_host,
    open_client,
    served_names,
    who_asks,
)
from ikservo.errors import IkservoError, PortError
from ikservo.files.reading import parse_json
from ikservo.serving.control_client import StopAllResult, StopResult
from ikservo.serving.replies import other_version_error, result_in

if TYPE_CHECKING:
    import zenoh

FLEET_VARIABLE = "IKSERVO_FLEET"

_ATTEMPTS, _PAUSE_S = 3, 0.1
_ANSWER_TIMEOUT_S = 2.0
_SCHEMA = "ikservo/net/1"
_MAX_REPLY_BYTES = 65_536


def stop_address(address: str) -> StopResult:
    """Stop the arm at an address, whoever controls it.

    Raises:
        BadValueError: The text is not an address.
        PortError: The arm cannot be reached, or has not confirmed the stop.
    """
    there = parse_address(address)
    found = stop_machine(there.endpoint, there.name)
    for error in found.errors:
        raise error
    return found.stopped[0]


def stop_listed_machines() -> StopAllResult:
    """Stop every arm on the machines in ``IKSERVO_FLEET`` and on this machine."""
    hosts: list[Endpoint] = []
    errors: list[IkservoError] = []
    for text in os.environ.get(FLEET_VARIABLE, "").replace(",", " ").split():
        try:
            hosts.append(parse_host(text))
        except IkservoError as error:
            errors.append(error)
    own = parse_host("127.0.0.1")
    if own not in hosts and listens(own):
        hosts.append(own)
    stopped = StopAllResult.joined(
        StopAllResult(errors=(found,)) if isinstance(found, IkservoError) else found
        for found in on_each_host(hosts, stop_machine)
    )
    return StopAllResult(stopped.stopped, (*errors, *stopped.errors))


def stop_machine(host: Endpoint, name: str = "*") -> StopAllResult:
    """Stop one arm or all arms of a machine; repeat for arms that have not confirmed the stop.

    Returns:
        The arms that have confirmed the stop, and an error for each arm that has not, or for the
        machine itself if no arm is known there.

    Raises:
        InputError: This machine has no certificate for the connection.
    """
    stop = _MachineStop(host, name, client_certificate(host))
    for _ in range(_ATTEMPTS):
        stop.attempt()
        if stop.is_confirmed:
            break
        time.sleep(_PAUSE_S)
    return stop.result()


class _MachineStop:
    """The state of a stop on one machine.

    Args:
        host: The machine.
        name: The name of the arm, or ``*``.
        certificate: The certificate of this machine.
    """

    def __init__(self, host: Endpoint, name: str, certificate: Certificate | None) -> None:
        self._host, self._name, self._certificate = host, name, certificate
        self._expected: set[str] = set() if name == "*" else {name}
        self._stopped: dict[str, StopResult] = {}
        self._errors: dict[str, IkservoError] = {}
        self._unreached: IkservoError | None = None

    @property
    def is_confirmed(self) -> bool:
        """Whether an arm is known, and all known arms have confirmed the stop."""
        return bool(self._stopped) and self._expected <= self._stopped.keys()

    def attempt(self) -> None:
        """Request the stop once."""
        self._errors.clear()
        try:
            with open_client([self._host], self._certificate) as session:
                self._unreached = None
                self._request(session)
                if self._name == "*":
                    self._expected |= set(served_names(session, _ANSWER_TIMEOUT_S))
        except PortError as error:
            self._unreached = error

    def result(self) -> StopAllResult:
        """Return the arms that have confirmed the stop, and an error for each other arm."""
        silent = sorted(self._expected - self._stopped.keys() - self._errors.keys())
        errors = [*self._errors.values(), *(self._not_confirmed(name) for name in silent)]
        if not (self._expected or self._stopped or errors):
            errors.append(self._not_confirmed(""))
        return StopAllResult(tuple(self._stopped.values()), tuple(errors))

    def _request(self, session: zenoh.Session) -> None:
        arguments = {"reason": f"Stopped by {who_asks()}.", "kind": "CLIENT"}
        request = json.dumps({"schema": _SCHEMA, "arguments": arguments}).encode()
        for key, data in ask(session, keys.stop(self._name), request, _ANSWER_TIMEOUT_S):
            name = key.split("/")[1]
            try:
                self._stopped[name] = _stop_result(data)
            except IkservoError as error:
                self._errors[name] = error

    def _not_confirmed(self, name: str) -> IkservoError:
        if self._unreached is not None:
            return self._unreached
        what = f"{name} at {self._host}" if name else str(self._host)
        text = f"The stop of {what} was not confirmed, because it does not answer."
        return PortError(text, "If the arm moves, switch off its power.")


def _stop_result(data: bytes) -> StopResult:
    """Return the result in a reply without ``wire_messages``, which imports too much."""
    reply: Any = None
    with contextlib.suppress(ValueError, RecursionError):
        reply = parse_json(data) if len(data) <= _MAX_REPLY_BYTES else None
    match reply:
        case {"schema": "ikservo/net/1", **fields}:
            return StopResult.of(result_in(cast("dict[str, Any]", fields)))
        case _:
            raise other_version_error()
