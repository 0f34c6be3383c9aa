"""The USB serial adapters that are plugged in: what they are and who holds them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from ikservo.clock import Clock, RealClock
from ikservo.hardware.line.holder import holder_of

__all__ = ["Adapter", "Change", "adapter_of", "adapters", "changes", "chip_name"]

_BY_ID = Path("/dev/serial/by-id")  # Linux: links named after maker, product and serial number

# fmt: off
#        vendor  product  chip, and the boards it is known from
_CHIPS = {
    (0x1A86, 0x55D3): "CH343 (Feetech, Waveshare)",
    (0x1A86, 0x55D4): "CH9102",
    (0x1A86, 0x7523): "CH340",
    (0x0403, 0x6001): "FT232R",
    (0x0403, 0x6010): "FT2232H",
    (0x0403, 0x6011): "FT4232H",
    (0x0403, 0x6014): "FT232H (U2D2)",
    (0x0403, 0x6015): "FT-X",
    (0x10C4, 0xEA60): "CP210x",
}
_MAKERS = {0x0403: "FTDI", 0x10C4: "Silicon Labs", 0x1A86: "WCH", 0x2F5D: "ROBOTIS"}
# fmt: on


@dataclass(frozen=True, slots=True)
class Adapter:
    """A serial port with USB behind it.

    Attributes:
        device: What ``--port`` takes: ``/dev/ttyACM0``, ``COM3``.
        by_id: The name that stays the same wherever it is plugged in; empty where there is none.
        vid: USB vendor id.
        pid: USB product id.
        serial_number: By which an arm's adapter is remembered; empty where it has none.
        description: As the adapter describes itself.
    """

    device: str
    by_id: str
    vid: int
    pid: int
    serial_number: str
    description: str = ""

    @property
    def chip(self) -> str:
        """Return the chip by vendor and product, or what the adapter says it is."""
        return chip_name(self.vid, self.pid) or self.description or "unknown"

    @property
    def usb(self) -> str:
        """Return vendor and product as ``lsusb`` writes them."""
        return f"{self.vid:04x}:{self.pid:04x}"

    @property
    def holder(self) -> str:
        """Return who has it open right now, as far as the system tells."""
        return holder_of(self.device)


@dataclass(frozen=True, slots=True)
class Change:
    """An adapter came or went."""

    event: Literal["plugged", "unplugged"]
    adapter: Adapter


def adapters() -> list[Adapter]:
    """Return the adapters that are plugged in, by device name."""
    from serial.tools import list_ports  # noqa: PLC0415  # slow on some systems

    links = _links()
    found = [
        Adapter(
            device=port.device,
            by_id=links.get(str(Path(port.device).resolve()), ""),
            vid=port.vid,
            pid=port.pid or 0,
            serial_number=port.serial_number or "",
            description=port.product or "",
        )
        for port in list_ports.comports()
        if port.vid is not None
    ]
    return sorted(found, key=lambda adapter: adapter.device)


def adapter_of(name: str, among: Sequence[Adapter] | None = None) -> Adapter | None:
    """Return the adapter behind a port's name, which may be a link to it; None if there is none."""
    if ":" in name and not name.upper().startswith("COM"):
        return None  # a URL or the simulator
    device = str(Path(name).resolve()) if name.startswith("/") else name
    found = adapters() if among is None else among
    return next((a for a in found if device in (a.device, str(Path(a.device).resolve()))), None)


def changes(clock: Clock | None = None, every_s: float = 0.2) -> Iterator[Change]:
    """Yield adapters as they come and go, from now on and without end.

    Args:
        clock: By which to look; the real one if None.
        every_s: Between two looks.
    """
    clock, before = clock or RealClock(), adapters()
    while True:
        clock.sleep_until(clock.now_s() + every_s)
        now = adapters()
        yield from (Change("unplugged", adapter) for adapter in before if adapter not in now)
        yield from (Change("plugged", adapter) for adapter in now if adapter not in before)
        before = now


def chip_name(vid: int, pid: int) -> str:
    """Return the chip of a USB vendor and product id, the maker alone, or nothing."""
    return _CHIPS.get((vid, pid)) or _MAKERS.get(vid, "")


def _links() -> dict[str, str]:
    """Return the by-id name of every device that has one."""
    try:
        return {str(link.resolve()): str(link) for link in _BY_ID.iterdir()}
    except OSError:  # no such folder: no adapter, or not Linux
        return {}
