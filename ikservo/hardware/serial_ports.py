"""Describe the serial ports of this machine: USB identity, users, errors on opening."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import stat
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal
from urllib.parse import urlsplit

from ikservo.clock import Clock, RealClock
from ikservo.errors import NoPortError, PortBusyError, PortError
from ikservo.hardware.vendor_modules import importing_from

with importing_from("pyserial", "serial"):
    from serial.tools import list_ports

_PROCESSES = Path("/proc")  # exists on Linux only; on other systems no process is named


def process_using(device: str) -> str:
    """Return ``command (process 123)`` of a process that has the device open; empty if none has."""
    target = Path(device).resolve()
    for process in _PROCESSES.glob("[0-9]*"):
        with contextlib.suppress(OSError):  # the process is another user's, or has just ended
            if any(link.readlink() == target for link in (process / "fd").iterdir()):
                return f"{_process_command(process)} (process {process.name})"
    return ""


def _process_command(process: Path) -> str:
    try:
        arguments = (process / "cmdline").read_bytes().split(b"\0")
    except OSError:
        return "a program"
    return b" ".join(arguments).decode(errors="replace").strip()[:80]


_BY_ID = Path("/dev/serial/by-id")  # Linux: links named after maker, product and serial number

# fmt: off
#        vendor  product  chip, and boards that are known to have it
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
class SerialAdapter:
    """A serial port on a USB adapter.

    Attributes:
        device: The argument of ``--port``: ``/dev/ttyACM0``, ``COM3``.
        by_id: The name that does not depend on the USB socket; empty if there is none.
        vid: USB vendor id.
        pid: USB product id.
        serial_number: The serial number, which identifies an arm's adapter; empty if there is none.
        description: The adapter's own description.
    """

    device: str
    by_id: str
    vid: int
    pid: int
    serial_number: str
    description: str = ""

    @property
    def chip(self) -> str:
        """The name of the chip, from vendor and product id, or the adapter's own description."""
        chip = _CHIPS.get((self.vid, self.pid)) or _MAKERS.get(self.vid)
        return chip or self.description or "unknown"

    @property
    def usb(self) -> str:
        """Vendor and product id in the notation of ``lsusb``."""
        return f"{self.vid:04x}:{self.pid:04x}"

    @property
    def used_by(self) -> str:
        """The process that has the port open, if known."""
        return process_using(self.device)


@dataclass(frozen=True, slots=True)
class AdapterEvent:
    """An adapter was plugged in or unplugged."""

    event: Literal["plugged", "unplugged"]
    adapter: SerialAdapter


def list_adapters() -> list[SerialAdapter]:
    """List the adapters that are plugged in, by device name."""
    links: dict[str, str] = {}
    with contextlib.suppress(OSError):  # the folder does not exist: no adapter, or not Linux
        links = {str(link.resolve()): str(link) for link in _BY_ID.iterdir()}
    found = [
        SerialAdapter(
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


def find_adapter(name: str, among: Sequence[SerialAdapter] | None = None) -> SerialAdapter | None:
    """Find the adapter behind a port's name, which may be a link to it; None if there is none."""
    if ":" in name and not name.upper().startswith("COM"):
        return None  # a URL or the simulator
    device = os.path.realpath(name) if name.startswith("/") else name
    found = list_adapters() if among is None else among
    return next((a for a in found if device in (a.device, str(Path(a.device).resolve()))), None)


def watch_adapters(clock: Clock | None = None, period_s: float = 0.2) -> Iterator[AdapterEvent]:
    """Yield an event whenever an adapter is plugged in or unplugged; never ends."""
    clock, before = clock or RealClock(), list_adapters()
    while True:
        clock.sleep_until(clock.now_s() + period_s)
        now = list_adapters()
        yield from (AdapterEvent("unplugged", adapter) for adapter in before if adapter not in now)
        yield from (AdapterEvent("plugged", adapter) for adapter in now if adapter not in before)
        before = now


RULES_FILE = "60-ikservo.rules"
_FOLDERS = (Path("/etc/udev/rules.d"), Path("/usr/lib/udev/rules.d"), Path("/run/udev/rules.d"))


def read_rules() -> str:
    """Read the udev rules from ``tools/60-ikservo.rules``, in the source or in the wheel."""
    package = Path(__file__).absolute().parents[1]
    shipped = package / "_rules"
    folder = shipped if shipped.is_dir() else package.parent / "tools"
    return (folder / RULES_FILE).read_text("utf-8")


def installed_rules() -> Path | None:
    """Return the path of the installed udev rules; None if they are not installed."""
    return next((f / RULES_FILE for f in _FOLDERS if (f / RULES_FILE).exists()), None)


def has_udev() -> bool:
    """Check whether this system uses udev rules."""
    return sys.platform == "linux"


_LINUX_MAJORS = range(136, 144)  # Documentation/admin-guide/devices.txt: Unix98 PTY slaves
_MACOS_NAME = re.compile(r"/dev/ttys\d+")


def is_pseudo_terminal(port_name: str) -> bool:
    """Check whether a port's name, after following links, is one end of a pseudo-terminal."""
    path = Path(port_name)
    try:
        device, mode = path.stat().st_rdev, path.stat().st_mode
        if sys.platform == "linux":
            return stat.S_ISCHR(mode) and os.major(device) in _LINUX_MAJORS
        return _MACOS_NAME.fullmatch(str(path.resolve())) is not None
    except (OSError, ValueError):
        return False


def line_hint(port_name: str, hint: str) -> str:
    """Return ``hint``, which is about plugs and cables, or another hint for a pseudo-terminal."""
    if not is_pseudo_terminal(port_name):
        return hint
    return (
        "A simulated bus has no plugs. Reduce the computer's load, then check the ids and the "
        "options of the simulator."
    )


_BUSY = {errno.EBUSY, errno.EAGAIN, errno.EWOULDBLOCK}
_NO_TERMINAL = {errno.EISDIR, errno.ENOTTY, errno.EINVAL, errno.ENXIO, errno.ENODEV}
_URL_FORMATS = "a network port is written as socket://192.168.1.5:4000"


def open_error(name: str, baud_rate: int, error: Exception) -> PortError:
    """Return an error that explains why a port did not open and what the user can do."""
    code = error.errno if isinstance(error, OSError) else None
    if code in _BUSY:
        return PortBusyError(name, process_using(name))
    if code in {errno.EACCES, errno.EPERM} or "PermissionError" in str(error):
        return PortError(f"No permission to open {name}.", _permission_hint(name))
    if isinstance(error, OverflowError) or "baud" in str(error).lower():
        return PortError(
            f"{name} does not support {baud_rate} baud.", "Choose a rate that the adapter supports."
        )
    if "://" in name:
        return NoPortError(
            name, list_devices(), _system_error_text(error) if _is_address(name) else _URL_FORMATS
        )
    if code == errno.ENOENT:
        return NoPortError(name, list_devices())
    inner = error.__context__ or error  # pyserial drops the system's number when it wraps an error
    number = inner.errno if isinstance(inner, OSError) else next(iter(inner.args), None)
    why = "not a serial port" if number in _NO_TERMINAL else _system_error_text(error)
    return NoPortError(name, list_devices(), why)


def _is_address(name: str) -> bool:
    """Check whether a URL has a known scheme, and host and port where required."""
    scheme = name.partition("://")[0]
    try:
        parts = urlsplit(name)
        return scheme not in {"socket", "rfc2217"} or bool(parts.hostname and parts.port)
    except ValueError:  # a port beyond 65535, or not a number
        return False


def _system_error_text(error: BaseException) -> str:
    """Return the system's error text, without pyserial's additions."""
    inner = error.__context__ or error
    if isinstance(inner, KeyError | TypeError):  # pyserial does not check the options of a URL
        return "an option of this address, or its value, is unknown"
    text = inner.strerror if isinstance(inner, OSError) else next(reversed(inner.args), None)
    return text.lower() if isinstance(text, str) else str(error)


def _permission_hint(name: str) -> str:
    if sys.platform != "linux":
        return "Another program may use it; end that program, or plug the adapter in again."
    group = "dialout"
    with contextlib.suppress(OSError, KeyError):
        group = Path(name).group()
    return (
        f"Add yourself to the port's group, then log in again: sudo usermod -aG {group} $USER "
        '(or a udev rule with TAG+="uaccess").'
    )


def list_devices() -> list[str]:
    """List the serial ports to which an arm may be connected, except those of the mainboard."""
    devices = sorted(port.device for port in list_ports.comports())
    return [device for device in devices if not device.startswith("/dev/ttyS")]
