"""The ``ikservo sim`` server: options, status display, main loop."""

from __future__ import annotations

import argparse
import contextlib
import gc
import json
import os
import signal
import sys
from collections.abc import Generator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from servosim.adapter import AdapterOptions
from servosim.arm_file import read_arm_file
from servosim.assembly import BenchServo, make_arm_world, make_bench_world
from servosim.errors import LogFileError, SimulatorError
from servosim.faults import read_faults
from servosim.hands import HANDS, add_hands
from servosim.line import Line, LineOptions
from servosim.pty import PtyBus
from servosim.remote import RemoteControl, servo_state
from servosim.servo_models import TABLES
from servosim.specimen import Specimen, read_specimen
from servosim.traffic import Audit, TrafficLog

EPILOG = """examples:
  ikservo sim so101 --link /tmp/arm
  ikservo sim --servo 1-3:xl430-w250 --servo 4-6:xl330-m288 --baud 1000000
  ikservo sim koch --faults faults.toml --log frames.txt --audit audit.json
"""


class ServerOptions(argparse.Namespace):
    """The command line options."""

    arm: Path | None
    groups: list[list[BenchServo]] | None
    servos: list[BenchServo]
    protocol: int | None
    baud: int | None
    urdf: Path | None
    pose: str | None
    seed: int | None
    link: Path | None
    faults: Path | None
    wire_time: bool
    physics: bool
    backlash_deg: float | None
    mass_scale: float | None
    payload_g: float | None
    parameters: Path | None
    goal_keeps_torque: bool
    hand: str | None
    log: Path | None
    audit: Path | None
    control: Path | None
    echo: bool
    noise: float
    usb_frame_ms: float
    latency_ms: float


def parse_options(argv: Sequence[str]) -> ServerOptions:
    """Parse the options; exits with a message if they make no sense."""
    parser = _make_parser()
    options = parser.parse_args(argv, ServerOptions())
    options.servos = [servo for group in options.groups or [] for servo in group]
    if bool(options.servos) == (options.arm is not None):
        parser.error(
            "give an arm or --servo, not both" if options.servos else "give an arm or --servo"
        )
    mine = ("protocol",) if options.arm is not None else _OF_AN_ARM
    for name in mine:
        if getattr(options, name):
            other = "--servo" if options.arm is not None else "an arm"
            parser.error(f"--{name.replace('_', '-')} is an option of {other}")
    return options


_OF_AN_ARM = ("urdf", "pose", "physics", "backlash_deg", "mass_scale", "payload_g", "parameters")


def _make_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="ikservo sim",
        description="Serve simulated servos behind a pseudo-terminal until Ctrl-C. "
        "The first line on stdout is the port.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("arm", nargs="?", type=Path, help="name or folder of the arm")
    add(
        "--servo",
        dest="groups",
        type=_parse_servos,
        action="append",
        metavar="IDS:MODEL",
        help="servos without an arm, such as 4:sts3215, 1-3:xl430-w250 or 1:sts3215@115200; may "
        "be repeated",
    )
    add(
        "--protocol", type=int, choices=(1, 2), help="protocol of the Dynamixel X servos in --servo"
    )
    add(
        "--baud",
        type=_parse_rate,
        help="baud rate of the servos (default with --servo: factory setting)",
    )
    add(
        "--urdf", type=Path, metavar="FILE", help="geometry of the arm (default: from its arm file)"
    )
    add("--pose", help="start pose of the arm (rest)")
    add("--seed", type=int, help="seed for random numbers and for the arm's tolerances (none)")
    add("--link", type=Path, help="symbolic link to the port, removed at exit")
    add("--faults", type=Path, metavar="FILE", help="TOML or JSON file with faults to inject")
    add(
        "--no-wire-time",
        dest="wire_time",
        action="store_false",
        help="transmit bytes without delay",
    )
    add("--physics", action="store_true", help="simulate bodies and contacts with MuJoCo")
    add("--backlash-deg", type=float, metavar="DEG", help="backlash of the arm's gears")
    add("--mass-scale", type=float, metavar="FACTOR", help="factor for the arm's masses (1)")
    add("--payload-g", type=float, metavar="GRAMS", help="mass in the arm's jaws (0)")
    add(
        "--parameters",
        type=Path,
        metavar="FILE",
        help="TOML file with the masses and motors of one arm",
    )
    add(
        "--hand",
        choices=HANDS,
        help="move limp joints by hand: sweep at once, or calibrate: hold the pose, then sweep; "
        "setup: plug in new servos one by one; box: new servos that a client of --control plugs in",
    )
    add(
        "--goal-keeps-torque",
        action="store_true",
        help="a goal written to an STS servo does not switch its torque on",
    )
    add("--log", type=Path, metavar="FILE", help="write each frame to this file")
    add("--audit", type=Path, metavar="FILE", help="write a JSON report to this file at exit")
    add("--control", type=Path, metavar="PATH", help="Unix socket for commands in JSON lines")
    add("--echo", action="store_true", help="echo the host's own bytes")
    add("--noise", type=float, default=0.0, help="probability that a byte has a flipped bit (0)")
    add("--usb-frame-ms", type=float, default=0.0, metavar="MS", help="USB frame time (0)")
    add("--latency-ms", type=float, default=0.0, metavar="MS", help="FTDI latency timer (0)")
    return parser  # fmt: skip


def _parse_servos(text: str) -> list[BenchServo]:
    """Parse ``1-3:xl430-w250``, ``1,4:sts3215`` or, with its own rate, ``7:ax-12a@57600``."""
    ids, _, wanted = text.partition(":")
    wanted, at, rate = wanted.partition("@")
    model = _find_model(wanted)
    if model is None:
        known = ", ".join(name.lower() for name in TABLES)
        raise argparse.ArgumentTypeError(f"no model {wanted!r} in {text!r}; known: {known}")
    try:
        numbers = [number for part in ids.split(",") for number in _parse_range(part)]
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{ids!r} are not ids; try 1-3:{wanted}") from error
    if not numbers:
        raise argparse.ArgumentTypeError(f"no id in {ids!r}; try 1-3:{wanted}")
    if not all(0 <= number <= 252 for number in numbers):
        raise argparse.ArgumentTypeError(f"ids go from 0 to 252, not {ids}")
    baud = _parse_rate(rate) if at else None
    return [BenchServo(number, model, baud) for number in numbers]


def _find_model(wanted: str) -> str | None:
    """Find the model with a name, or the only model whose name starts with it: ax-12 is AX-12A."""
    models = {name.lower(): name for name in TABLES}
    if wanted.lower() in models:
        return models[wanted.lower()]
    longer = [name for lower, name in models.items() if wanted and lower.startswith(wanted.lower())]
    return longer[0] if len(longer) == 1 else None


def _parse_rate(text: str) -> int:
    if not text.isascii() or not text.isdigit() or int(text) == 0:
        raise argparse.ArgumentTypeError(f"{text!r} is not a rate; try 1000000")
    return int(text)


def _parse_range(part: str) -> range:
    first, _, last = part.partition("-")
    return range(int(first), int(last or first) + 1)


REFRESH_S = 0.25
REAL_TIME_NICENESS = -10
HEAD = (
    f"{'id':>3}  {'model':<11} {'joint':<16}{'position':>9}{'goal':>7}{'load':>7}{'°C':>5}{'V':>6}"
)


class StatusScreen:
    """Writes the port to stdout; on a terminal also a table that is kept up to date."""

    def __init__(self, bus: PtyBus) -> None:
        self._bus = bus
        plain = "NO_COLOR" in os.environ or os.environ.get("TERM") == "dumb"
        self._live = sys.stdout.isatty() and not plain
        self._shown: list[str] = []
        self._next_s = 0.0

    def __enter__(self) -> StatusScreen:
        return self

    def __exit__(self, *_: object) -> None:
        if self._live:
            self._write_text("\x1b[?25h")

    def announce(self) -> None:
        """Print the port."""
        self._write_text(
            f"{self._bus.link or self._bus.path}\n" if self._live else f"{self._bus.path}\n"
        )
        if self._live:
            self._write_text("\x1b[?25l")

    def refresh(self) -> None:
        """Update the table, if there is one and it is due."""
        now_s = self._bus.now_s()
        if not self._live or now_s < self._next_s:
            return
        self._next_s = now_s + REFRESH_S
        world = self._bus.line.world
        rows = [servo_state(joint, servo) for joint in world.joints for servo in joint.servos]
        lines = [HEAD, *(_format_servo_row(row) for row in rows)]
        if lines != self._shown:
            up = f"\x1b[{len(self._shown)}A" if self._shown else ""
            self._write_text(up + "".join(f"\x1b[2K{line}\n" for line in lines))
            self._shown = lines

    def _write_text(self, text: str) -> None:
        with contextlib.suppress(OSError):  # servos keep running without the terminal
            sys.stdout.write(text)
            sys.stdout.flush()


def _format_servo_row(state: dict[str, Any]) -> str:
    marks = ("torque " if state["torque"] else "") + ("ALARM" if state["alarm"] else "")
    return (
        f"{state['id']:>3}  {state['model']:<11} {state['joint']:<16}{state['position']:>9}"
        f"{state['goal']:>7}{state['load']:>6.0%} {state['temperature_c']:>5.1f}"
        f"{state['voltage_v']:>6.1f}  {marks}"
    )


ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)  # SIGHUP: its terminal was closed
GAP_S = 0.020  # a client's scheduler may split frames, unlike a wire


def serve(argv: Sequence[str]) -> int:
    """Serve an arm or single servos until SIGINT, SIGTERM or SIGHUP; the first line is the port.

    Args:
        argv: Path of an ``arm.toml`` or ``--servo``, then options; ``--help`` lists them.

    Returns:
        0 after a signal, 1 when a log cannot be written, 2 when the options cannot be used.
    """
    options = parse_options(argv)
    try:
        with contextlib.ExitStack() as stack:
            try:
                bus, remote, screen = _open_server(options, stack)
            except (SimulatorError, OSError) as error:
                sys.stderr.write(f"{error}\n")
                return 2
            _work_until_signal(bus, remote, screen)
    except LogFileError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    return 0


def _open_server(
    options: ServerOptions, stack: contextlib.ExitStack
) -> tuple[PtyBus, RemoteControl, StatusScreen]:
    """Build and open everything; the stack closes it again, the port last."""
    line = build_line(options)
    bus = PtyBus(line, options.link)
    stack.callback(bus.unplug)
    _attach_listeners(line, options, stack)
    remote = stack.enter_context(RemoteControl(options.control, line))
    return bus, remote, stack.enter_context(StatusScreen(bus))


def build_line(options: ServerOptions) -> Line:
    """Build the line that the options describe.

    Raises:
        SimulatorError: An arm file, a model, a rate or a fault cannot be used.
    """
    line_options = LineOptions(
        wire_time=options.wire_time,
        gap_s=GAP_S,
        noise=options.noise,
        seed=options.seed or 0,
        adapter=AdapterOptions(
            options.echo, options.usb_frame_ms / 1000, options.latency_ms / 1000
        ),
    )
    if options.arm is not None:
        arm = read_arm_file(options.arm, options.urdf or "")
        arm = replace(arm, baud=options.baud or arm.baud)
        own = Specimen() if options.parameters is None else read_specimen(options.parameters)
        world = make_arm_world(
            arm,
            options.pose or "rest",
            options.seed,
            physics=options.physics,
            backlash_deg=options.backlash_deg,
            specimen=own.with_load(options.mass_scale, options.payload_g),
        )
        line = Line(world, arm.baud, line_options)
    else:
        world = make_bench_world(
            options.servos, options.baud, options.seed or 0, protocol=options.protocol
        )
        line = Line(world, options.baud or world.servos[0].baud, line_options)
    if options.goal_keeps_torque:
        world.keep_torque_with_goals()
    for fault in read_faults(options.faults) if options.faults else []:
        line.faults.add(fault)
    if options.hand:
        add_hands(line, options.hand)
    return line


def _attach_listeners(line: Line, options: ServerOptions, stack: contextlib.ExitStack) -> None:
    if options.log is not None:
        journal = TrafficLog(options.log, line.world.servos)
        stack.callback(journal.close)
        line.witnesses.append(journal)
    if options.audit is not None:
        audit = Audit(line.world.servos)
        line.witnesses.append(audit)
        written = options.audit.with_name(f"{options.audit.name}.part")
        written.touch()  # reports an unwritable path now instead of at the end
        stack.callback(_write_report, written, options.audit, audit, line)


def _write_report(written: Path, path: Path, audit: Audit, line: Line) -> None:
    """Write the audit next to its file, and rename it."""
    text = json.dumps(audit.report(list(line.readers.values())), indent=2)
    try:
        written.write_text(f"{text}\n", encoding="utf-8")
        written.replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):
            written.unlink(missing_ok=True)
        raise LogFileError(path, error) from error


def _work_until_signal(bus: PtyBus, remote: RemoteControl, screen: StatusScreen) -> None:
    gc.freeze()
    _raise_priority()
    with _signals_as_pipe() as signalled:
        screen.announce()
        while True:
            ready = bus.process_events((signalled, *remote.socket_fds()))
            if signalled in ready or remote.serve(ready):
                return
            screen.refresh()


def _raise_priority() -> None:
    """Raise this process's priority, if permitted: real servos do not share a processor."""
    with contextlib.suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, REAL_TIME_NICENESS)
        if os.getsid(0) == os.getpid():  # Linux may divide processors among sessions first
            with contextlib.suppress(OSError):
                Path("/proc/self/autogroup").write_text(str(REAL_TIME_NICENESS))


@contextlib.contextmanager
def _signals_as_pipe() -> Generator[int, None, None]:
    """Yield a file descriptor that is readable once a signal to end has arrived."""
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    before = signal.set_wakeup_fd(writer)
    handlers = {number: signal.signal(number, _ignore_signal) for number in ENDING}
    try:
        yield reader
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(before)
        os.close(reader)
        os.close(writer)


def _ignore_signal(_: int, __: object) -> None:
    """Do nothing, because the wake-up pipe reports the signal."""
