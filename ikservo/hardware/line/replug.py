"""The same adapter again after its cable was pulled, under whatever name it now has."""

from __future__ import annotations

from ikservo.clock import Clock, RealClock
from ikservo.errors import PortError, PortLostError
from ikservo.hardware.line.adapters import adapter_of, adapters
from ikservo.hardware.line.port import Port
from ikservo.hardware.line.transport import open_transport

__all__ = ["reopen", "serial_number_of"]

_LOOK_EVERY_S = 0.1


def serial_number_of(name: str) -> str:
    """Return the USB serial number of the adapter behind a port's name, or nothing.

    To be asked while the adapter is plugged in, so that it is known when it comes back.
    """
    adapter = adapter_of(name)
    return adapter.serial_number if adapter else ""


def reopen(port: Port, serial_number: str, within_s: float, clock: Clock | None = None) -> None:
    """Open a lost port again as soon as its adapter is back; nothing is sent, nothing moves.

    An adapter without a serial number is taken back under its old name only.

    Args:
        port: The port that was lost.
        serial_number: From ``serial_number_of``, before the loss.
        within_s: How long to wait for it.
        clock: By which to wait; the real one if None.

    Raises:
        PortLostError: It did not come back in time.
    """
    clock = clock or RealClock()
    give_up_s = clock.now_s() + within_s
    port.close()
    while not _opened_again(port, serial_number):
        if clock.now_s() >= give_up_s:
            raise PortLostError(port.name, f"not reconnected within {within_s:.0f} s")
        clock.sleep_until(min(clock.now_s() + _LOOK_EVERY_S, give_up_s))


def _opened_again(port: Port, serial_number: str) -> bool:
    here = adapters()
    names = [a.device for a in here if a.serial_number == serial_number] if serial_number else []
    for name in names or ([] if serial_number else [port.name]):
        try:
            port.connect(open_transport(name, port.baudrate), name, port.baudrate)
        except PortError:  # it is there, but its device node is not ready, or another was quicker
            continue
        return True
    return False
