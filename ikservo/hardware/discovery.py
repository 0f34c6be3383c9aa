"""Which ports there are, and which one is meant when none is named."""

from __future__ import annotations

from ikservo.errors import NoPortError

__all__ = ["candidates", "choose_port"]


def candidates() -> list[str]:
    """Return the serial ports with a USB adapter behind them, by device name."""
    from serial.tools import list_ports  # noqa: PLC0415  # slow on some systems

    return sorted(port.device for port in list_ports.comports() if port.vid is not None)


def choose_port(name: str | None) -> str:
    """Return the named port, or the only candidate.

    Raises:
        NoPortError: None is named and there is not exactly one to choose.
    """
    if name:
        return name
    found = candidates()
    if len(found) == 1:
        return found[0]
    why = "several adapters are plugged in; name one with --port" if found else ""
    raise NoPortError("", found, why)
