"""Stops arms on other machines, whoever controls them, and asks again until they confirm it."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, cast

from ikservo.arm.control_client import StopAllResult, StopResult
from ikservo.errors import IkservoError, PortError
from ikservo.network import key_expressions as keys
from ikservo.network.address import Endpoint
from ikservo.network.certificates import client_certificate
from ikservo.network.connection import who_asks
from ikservo.network.fleet import on_each_host, served_names
from ikservo.network.messages import ServiceRequest, arguments_of, encode, result_of
from ikservo.network.session import Certificate, ask, open_client

if TYPE_CHECKING:
    from collections.abc import Sequence

    import zenoh

__all__ = ["stop_machine", "stop_machines"]

_ATTEMPTS, _PAUSE_S = 3, 0.1
_ANSWER_TIMEOUT_S = 2.0


def stop_machines(hosts: Sequence[Endpoint]) -> StopAllResult:
    """Stop every arm of some machines, all at the same time."""
    return StopAllResult.joined(
        StopAllResult(errors=(found,)) if isinstance(found, IkservoError) else found
        for found in on_each_host(list(hosts), stop_machine)
    )


def stop_machine(host: Endpoint, name: str = "*") -> StopAllResult:
    """Stop the arms of a machine; ask again where one has not confirmed it.

    Args:
        host: Where they are served.
        name: Under which name; every arm of that machine if not given.

    Returns:
        The arms that have confirmed it, and an error for each that has not; with an error for the
        machine itself where none is known there.

    Raises:
        InputError: This machine has no certificate for it.
    """
    stop = _MachineStop(host, name, client_certificate(host))
    for _ in range(_ATTEMPTS):
        stop.attempt()
        if stop.is_confirmed:
            break
        time.sleep(_PAUSE_S)
    return stop.result()


class _MachineStop:
    """What is known of the stop of one machine.

    Args:
        host: The machine.
        name: Of its arm, or ``*``.
        certificate: Of this machine.
    """

    def __init__(self, host: Endpoint, name: str, certificate: Certificate | None) -> None:
        self._host, self._name, self._certificate = host, name, certificate
        self._expected: set[str] = set() if name == "*" else {name}
        self._stopped: dict[str, StopResult] = {}
        self._errors: dict[str, IkservoError] = {}
        self._unreached: IkservoError | None = None

    @property
    def is_confirmed(self) -> bool:
        """Whether all that are known have confirmed it, and one is known."""
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
        """Return what was confirmed, and an error for what was not."""
        silent = sorted(self._expected - self._stopped.keys() - self._errors.keys())
        errors = [*self._errors.values(), *(self._not_confirmed(name) for name in silent)]
        if not (self._expected or self._stopped or errors):
            errors.append(self._not_confirmed(""))
        return StopAllResult(tuple(self._stopped.values()), tuple(errors))

    def _request(self, session: zenoh.Session) -> None:
        arguments = arguments_of({"reason": f"Stopped by {who_asks()}.", "kind": "CLIENT"})
        request = encode(ServiceRequest(schema="ikservo/net/1", arguments=arguments))
        for key, data in ask(session, keys.stop(self._name), request, _ANSWER_TIMEOUT_S):
            name = key.split("/")[1]
            try:
                self._stopped[name] = cast("StopResult", result_of(data))
            except IkservoError as error:
                self._errors[name] = error

    def _not_confirmed(self, name: str) -> IkservoError:
        if self._unreached is not None:
            return self._unreached
        what = f"{name} at {self._host}" if name else str(self._host)
        return PortError(
            f"The stop of {what} was not confirmed: it does not answer.",
            "If the arm moves, switch off its power.",
        )
