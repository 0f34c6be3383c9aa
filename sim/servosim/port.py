"""The bus in this process: a transport with the interface of pyserial's Serial, in virtual time."""

from __future__ import annotations

from pathlib import Path
from urllib.parse import parse_qs, unquote, urlsplit

from servosim.adapter import AdapterOptions
from servosim.arm_file import read_arm_file
from servosim.assembly import make_arm_world
from servosim.clock import PacedClock, VirtualClock
from servosim.errors import PortClosedError, SimulatorError
from servosim.faults import read_faults
from servosim.hands import add_hands
from servosim.line import Line, LineOptions
from servosim.specimen import Specimen, read_specimen
from servosim.surroundings import parse_cubes

POLL_S = 10e-6  # virtual time of a poll of the buffer, so that polling loops end


def open_port(url: str) -> SimulatedPort:
    """Open a port to a fresh simulated arm: ``sim:/path/to/arm.toml?seed=3&pose=home``.

    The query may contain ``urdf`` (a file that replaces the arm file's), ``pose``, ``seed``,
    ``faults`` (a file), ``hand`` (sweep, calibrate, setup, box), and ``physics``, ``backlash_deg``,
    ``goal_keeps_torque``, ``echo``, ``noise``, ``wire_time``, ``usb_frame_ms``, ``latency_ms`` as
    numbers; ``paced=1`` limits virtual time to real time. ``mass_scale`` and ``payload_g`` change
    the masses, ``parameters`` is a file with those of one arm. With ``physics=1`` cubes may stand
    on the table, ``cubes=red@0.24,-0.06;blue@0.2,0.08``; a simulated camera sees them, and a board
    on the tip unless ``board=0``.

    Raises:
        ArmFileError: The arm file cannot be used.
        FaultError: The fault file cannot be used.
        SimulatorError: The URL is not valid, or the arm cannot be built.
    """
    parts = urlsplit(url)
    if parts.scheme != "sim" or not parts.path:
        raise SimulatorError(
            f"{url!r} is not the address of a simulated bus; try sim:/path/arm.toml"
        )
    query = _Query(parts.query)
    chosen = query.optional("seed")
    seed = None if chosen is None else int(chosen)
    arm = read_arm_file(Path(unquote(parts.path)), query.text("urdf", ""))
    world = make_arm_world(
        arm,
        query.text("pose", "rest"),
        seed,
        physics=bool(query.number("physics", 0)),
        backlash_deg=query.optional("backlash_deg"),
        specimen=query.specimen(),
        cubes=parse_cubes(query.text("cubes", "")),
        has_board=bool(query.number("board", 1)),
    )
    if query.number("goal_keeps_torque", 0):
        world.keep_torque_with_goals()
    line = Line(world, arm.baud, query.line_options(seed or 0))
    if query.text("faults", ""):
        for fault in read_faults(Path(query.text("faults", ""))):
            line.faults.add(fault)
    if query.text("hand", ""):
        add_hands(line, query.text("hand", ""))
    paced = bool(query.number("paced", 0))
    query.check()
    return SimulatedPort(line, url, paced=paced)


class _Query:
    """The query of a URL."""

    def __init__(self, text: str) -> None:
        self._values = {key: values[-1] for key, values in parse_qs(text).items()}
        self._used_keys: set[str] = set()

    def text(self, key: str, default: str) -> str:
        """Return a value as text."""
        self._used_keys.add(key)
        return self._values.get(key, default)

    def number(self, key: str, default: float) -> float:
        """Return a value as a number."""
        value = self.text(key, str(default))
        try:
            return float(value)
        except ValueError as error:
            raise SimulatorError(f"{key}={value} is not a number") from error

    def optional(self, key: str) -> float | None:
        """Return a value as a number, or None if it is missing."""
        return self.number(key, 0.0) if self.text(key, "") else None

    def specimen(self) -> Specimen:
        """Return the masses and motors of the arm."""
        file = self.text("parameters", "")
        own = read_specimen(Path(file)) if file else Specimen()
        return own.with_load(self.optional("mass_scale"), self.optional("payload_g"))

    def line_options(self, seed: int) -> LineOptions:
        """Return the options of the line."""
        adapter = AdapterOptions(
            echo=bool(self.number("echo", 0)),
            usb_frame_s=self.number("usb_frame_ms", 0) / 1000,
            latency_s=self.number("latency_ms", 0) / 1000,
        )
        return LineOptions(
            wire_time=bool(self.number("wire_time", 1)),
            noise=self.number("noise", 0),
            seed=seed,
            adapter=adapter,
        )

    def check(self) -> None:
        """Raise an error if the query has unknown keys."""
        unknown = sorted(set(self._values) - self._used_keys)
        if unknown:
            known = ", ".join(sorted(self._used_keys))
            raise SimulatorError(f"a simulated bus has no option {unknown[0]!r}; known: {known}")


class SimulatedPort:
    """A serial port whose other end is a simulated line.

    Time is virtual: it passes in ``read`` while bytes are pending, and in ``clock.sleep_until``;
    nothing sleeps, unless time is ``paced`` for display.

    Attributes:
        port: The address with which it was opened.
        timeout: Seconds that ``read`` waits; None waits for all bytes, 0 does not wait.
        clock: The virtual clock.
        line: The simulated line, for tests: ``line.servos[1].read("present_position")``.
        is_open: False after ``close`` or a pulled cable.
    """

    def __init__(self, line: Line, port: str = "sim:", *, paced: bool = False) -> None:
        self.line, self.port = line, port
        clock = PacedClock if paced else VirtualClock
        self.clock: VirtualClock = clock(on_advance=line.run_until)
        self.timeout: float | None = None
        self.is_open = True

    @property
    def baudrate(self) -> int:
        """The rate in bit/s; servos at another rate do not reply."""
        return self.line.baud

    @baudrate.setter
    def baudrate(self, baud: int) -> None:
        self.line.set_baud(baud)

    @property
    def in_waiting(self) -> int:
        """The number of bytes that have arrived."""
        self._check_open()
        waiting = self.line.inbox.count_arrived(self.clock.now_s())
        self._poll_adapter()
        return waiting

    def read(self, size: int = 1) -> bytes:
        """Return ``size`` bytes, or those that have arrived by the timeout."""
        self._check_open()
        start_s = self.clock.now_s()
        self.line.run_until(start_s)
        deadline_s = None if self.timeout is None else start_s + self.timeout
        while not self._is_read_complete(size, deadline_s):
            pass
        data = self.line.inbox.take(size, self.clock.now_s())
        if len(data) < size and self.timeout == 0:
            self._poll_adapter()
        return data

    def write(self, data: bytes) -> int:
        """Pass bytes to the adapter; they leave one after the other while time passes."""
        self._check_open()
        self.line.host_write(bytes(data), self.clock.now_s())
        return len(data)

    def flush(self) -> None:
        """Wait until everything written has left."""
        self._check_open()
        self.clock.sleep_until(self.line.host_end_s)

    def reset_input_buffer(self) -> None:
        """Discard the bytes that have arrived."""
        self._check_open()
        self.line.inbox.clear(self.clock.now_s())

    def reset_output_buffer(self) -> None:
        """Do nothing, because an adapter sends the bytes that it has received."""
        self._check_open()

    def close(self) -> None:
        """Close the port; the servos stay as they are."""
        self.is_open = False

    def __enter__(self) -> SimulatedPort:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _is_read_complete(self, size: int, deadline_s: float | None) -> bool:
        """Check whether a read may return; if not, advance time to the next event."""
        now_s, inbox = self.clock.now_s(), self.line.inbox
        if inbox.count_arrived(now_s) >= size:
            return True
        if deadline_s is not None and now_s >= deadline_s:
            return True
        events = [inbox.arrival_time_s(size), self.line.next_event_s, deadline_s]
        if events[0] is None and events[1] is None:
            events.append(inbox.last_s())
        coming = [at_s for at_s in events if at_s is not None and at_s > now_s]
        if not coming:
            return True
        self.clock.sleep_until(min(coming))
        return False

    def _poll_adapter(self) -> None:
        self.clock.sleep_until(self.clock.now_s() + POLL_S)

    def _check_open(self) -> None:
        if not self.is_open or not self.line.plugged:
            raise PortClosedError
