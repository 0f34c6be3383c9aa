"""Is everything well between this computer and the servos? Looks, measures, changes nothing."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence

from ikservo.arm.care.findings import Finding, bad, good, odd
from ikservo.arm.care.servo_checks import check_servos
from ikservo.arm.line import chosen_port, servo_specs
from ikservo.errors import BusError, PortError
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.finding.chain_order import silence_hint
from ikservo.hardware.finding.crowds import UNCROWD, crowded
from ikservo.hardware.finding.discovery import baud_rates, choose_port, with_arm
from ikservo.hardware.finding.identify import Found
from ikservo.hardware.finding.probe import LineQuality, probe
from ikservo.hardware.finding.scanning import scan
from ikservo.hardware.line.adapters import Adapter, adapter_of
from ikservo.hardware.line.port import Port, open_port
from ikservo.hardware.line.udev import RULES_FILE, has_udev, installed_rules, read_rules
from ikservo.hardware.servo import ServoSpec
from ikservo.model import Model

__all__ = ["READS", "check_up", "rules_text"]

READS = 1000
"""Reads by which the line is judged."""

_SLOW_S = 0.004  # median; a USB frame is 1 ms, FTDI's timer 16 ms
_BAD_LOSS = 0.01
_INSTALL = (
    f"ikservo doctor --rules | sudo tee /etc/udev/rules.d/{RULES_FILE} && "
    "sudo udevadm control --reload && sudo udevadm trigger"
)

Progress = Callable[[str, float, float], None]


def check_up(
    port: str | None = None, model: Model | None = None, on_progress: Progress | None = None
) -> Iterator[Finding]:
    """Yield what is found, from the adapter up to the servos; ends where nothing more can be told.

    Args:
        port: See ``choose_port``.
        model: The arm that should be on it; without, whoever answers is looked at.
        on_progress: Told what is being done, how much of it is done, and of how much.

    Raises:
        InputError: The model names no servos, or a bus is to be simulated without one.
    """
    try:
        name = chosen_port(model, port) if model else with_arm(choose_port(port), None)
    except PortError as error:
        yield bad("port", error.message, error.command_hint)
        name = ""
    else:
        yield from _adapter(name)
        yield from _port(name, model, on_progress)
    yield from _rules(name)


def _port(name: str, model: Model | None, on_progress: Progress | None) -> Iterator[Finding]:
    try:
        line = open_port(name, model.baud_rate if model else baud_rates()[0])
    except PortError as error:
        yield bad("port", error.message, error.command_hint)
        return
    with line:
        yield good("port", f"{name} can be opened; no other program uses it")
        yield from _line(line, model, on_progress)


def rules_text() -> str:
    """Return the udev rules, ready to be piped into a file."""
    return read_rules()


def _adapter(name: str) -> Iterator[Finding]:
    adapter = adapter_of(name)
    if adapter:
        number = f"serial number {adapter.serial_number}" if adapter.serial_number else ""
        missing = "no serial number: arms cannot be recognised by their adapter"
        yield good("adapter", f"{adapter.chip} at {adapter.device}, {number or missing}")


def _rules(name: str) -> Iterator[Finding]:
    if not has_udev() or name.startswith("sim:") or "://" in name:
        return
    where = installed_rules()
    if where:
        yield good("udev", f"{where} is installed")
        return
    yield odd(
        "udev",
        f"{RULES_FILE} is not installed: it gives access to adapters and lowers FTDI latency",
        _INSTALL,
    )


def _line(line: Port, model: Model | None, on_progress: Progress | None) -> Iterator[Finding]:
    if model is None:
        found = _scanned(line, on_progress)
        yield _crowd(found)
        specs = [ServoSpec(f.id, f.table) for f in found if f.table and not f.crowded]
    else:
        specs = servo_specs(model)
    bus = ServoBus(line, specs, retries=0)
    crowds = crowded(bus) if model else []
    if crowds:
        yield _crowded(spec.id for spec in crowds)
        specs = [spec for spec in specs if spec not in crowds]
    there = [spec for spec in specs if model is None or _answers(bus, spec.id)]
    if model and specs:
        yield from _presence(line, specs, there, on_progress)
    if not there:
        return
    quality = probe(bus, [s.id for s in there], READS, _told(on_progress))
    yield from _quality(quality, bus, adapter_of(line.name))
    yield from check_servos(ServoBus(line, there), model)


def _scanned(line: Port, on_progress: Progress | None) -> list[Found]:
    return scan(
        line,
        on_step=on_progress
        and (lambda s: on_progress(f"{s.baud_rate} baud, {s.protocol}", s.asked, s.ids)),
    )


def _told(on_progress: Progress | None) -> Callable[[int], None] | None:
    return on_progress and (lambda count: on_progress("reading positions", count, READS))


def _crowd(found: Sequence[Found]) -> Finding:
    crowds = [f.id for f in found if f.crowded]
    if crowds:
        return _crowded(crowds)
    if not found:
        return bad("servos", "no servo answers at any baud rate", _NO_POWER)
    return good("servos", f"{len(found)} answer at {found[0].baud_rate} baud: {_models(found)}")


def _crowded(ids: Iterable[int]) -> Finding:
    listed = ", ".join(map(str, ids))
    return bad("servos", f"several servos answer at id {listed}", UNCROWD)


_NO_POWER = "Check that the servos' power supply is on and the cable is in the right socket."


def _models(found: Sequence[Found]) -> str:
    return ", ".join(f"{servo.model or 'unknown'} (id {servo.id})" for servo in found)


def _answers(bus: ServoBus, servo_id: int) -> bool:
    for _ in range(3):
        try:
            bus.ping(servo_id)
        except BusError:
            continue
        return True
    return False


def _presence(
    line: Port, specs: Sequence[ServoSpec], there: Sequence[ServoSpec], on_progress: Progress | None
) -> Iterator[Finding]:
    silent = [spec for spec in specs if spec not in there]
    if not silent:
        yield good("servos", f"all {len(specs)} answer at {line.baudrate} baud")
    elif there:
        names = ", ".join(map(str, silent))
        hint = silence_hint(specs, [s.id for s in there], [s.id for s in silent])
        yield bad("servos", f"no answer from {names}", hint)
    else:
        rate = line.baudrate
        elsewhere = _scanned(line, on_progress)
        line.setBaudRate(rate)
        yield _strangers(elsewhere, rate)


def _strangers(found: Sequence[Found], rate: int) -> Finding:
    if not found:
        return bad("servos", f"no servo answers, at {rate} baud or any other", _NO_POWER)
    return bad(
        "servos",
        f"none of this arm's servos answers; on the bus: {'; '.join(str(f) for f in found)}",
        "If it is another arm, choose it with --arm. If the servos are new: ikservo setup ARM",
    )


def _quality(quality: LineQuality, bus: ServoBus, adapter: Adapter | None) -> Iterator[Finding]:
    if quality.round_trips_s:
        yield _latency(quality, adapter)
    lost = sum(quality.lost.values())
    text = f"{lost} of {quality.asked} reads lost"
    if not lost:
        yield good("loss", text)
        return
    who = ", ".join(f"{bus.servos[i]}: {count}" for i, count in quality.lost.items())
    kind = bad if quality.lost_share > _BAD_LOSS else odd
    yield kind("loss", f"{text} ({who})", "Check for loose connectors, a weak supply, long cables.")


def _latency(quality: LineQuality, adapter: Adapter | None) -> Finding:
    median_s, late_s = quality.round_trip_s(0.5), quality.round_trip_s(0.99)
    text = f"a read takes {1000 * median_s:.2f} ms (median), {1000 * late_s:.2f} ms (p99)"
    if median_s < _SLOW_S:
        return good("latency", text)
    ftdi = adapter is not None and adapter.vid == 0x0403
    hint = "The FTDI chip buffers bytes; install the udev rule" if ftdi else "The adapter is slow"
    return odd("latency", text, f"{hint}; set the servos' return delay to 0: ikservo setup ARM")
