"""Diagnose adapter, bus and servos."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress

from ikservo.apps.workbench.findings import Finding, failure, ok, warning
from ikservo.apps.workbench.line_quality import LineQuality, measure_line_quality
from ikservo.apps.workbench.servo_checks import check_servos
from ikservo.arm.opening import resolve_port, servo_specs
from ikservo.calibration.calibration_file import read_calibration, ways_out
from ikservo.calibration.paths import calibrations_of, journals_of
from ikservo.errors import BusError, FileFormatError, IkservoError, PortError
from ikservo.files.reading import config_dir
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.duplicate_ids import DUPLICATE_ID_HINT, find_duplicate_ids
from ikservo.hardware.port import Port, open_port
from ikservo.hardware.port_choice import choose_port, simulated_port_url
from ikservo.hardware.port_names import is_simulated
from ikservo.hardware.requester import silence_hint
from ikservo.hardware.scan import FoundServo, candidate_baud_rates, scan
from ikservo.hardware.serial_ports import (
    RULES_FILE,
    SerialAdapter,
    find_adapter,
    has_udev,
    installed_rules,
    line_hint,
)
from ikservo.hardware.servo import ServoSpec
from ikservo.model import Model, arm_names, load_model

READS = 1000
"""Number of position reads that measure the line quality."""

_SLOW_S = 0.004  # a slower median is reported; a USB frame is 1 ms, FTDI's timer 16 ms
_MAX_LOSS_FRACTION = 0.01
_INSTALL = (
    f"ikservo doctor --rules | sudo tee /etc/udev/rules.d/{RULES_FILE} && "
    "sudo udevadm control --reload && sudo udevadm trigger"
)

Progress = Callable[[str, float, float], None]


def diagnose(
    port: str | None = None, model: Model | None = None, on_progress: Progress | None = None
) -> Iterator[Finding]:
    """Diagnose adapter, port, bus and servos; stop at a failure that prevents further checks.

    Args:
        port: See ``choose_port``.
        model: The expected arm; None: check all servos that reply.
        on_progress: Called with the current step, its progress and its total.

    Raises:
        InputError: The model has no servos, or a simulated bus needs a model.
    """
    try:
        name = resolve_port(model, port) if model else simulated_port_url(choose_port(port), None)
    except PortError as error:
        yield failure("port", error.message, error.command_hint)
        name = ""
    else:
        adapter = find_adapter(name)
        if adapter:
            number = f"serial number {adapter.serial_number}" if adapter.serial_number else ""
            missing = "no serial number, so arms cannot be recognised by their adapter"
            yield ok("adapter", f"{adapter.chip} at {adapter.device}, {number or missing}")
        yield from _check_port(name, model, on_progress)
    yield from _check_udev_rules(name)
    yield from _check_calibrations(name, model)


def _check_calibrations(name: str, model: Model | None) -> Iterator[Finding]:
    """Check that every calibration of this user, or of the given arm, can be read."""
    if is_simulated(name):
        return
    arm = model.name if model else ""
    for path in journals_of(arm):
        yield failure(
            "zeros",
            f"a calibration was interrupted while it changed servos; its journal is {path}",
            f"Undo it: ikservo calibration revert {arm or path.stem.partition('-')[0]}",
        )
    paths = calibrations_of(arm) if arm else sorted((config_dir() / "arms").glob("*.toml"))
    for path in paths:
        try:
            found = read_calibration(path)
        except FileFormatError as error:
            text = f"the calibration {error.message}"
            yield failure("zeros", text, ways_out(path, arm or path.stem.partition("-")[0]))
        else:
            adapter = found.usb_serial_number or "without a serial number"
            text = f"{found.arm} was calibrated on {found.written:%Y-%m-%d}, adapter {adapter}"
            yield ok("zeros", text)
    if model and not paths and any(joint.zero_from == "nominal" for joint in model.joints):
        yield warning("zeros", f"{arm} is not calibrated", f"Calibrate it: ikservo calibrate {arm}")


def _check_port(name: str, model: Model | None, on_progress: Progress | None) -> Iterator[Finding]:
    try:
        opened_port = open_port(name, model.baud_rate if model else candidate_baud_rates()[0])
    except PortError as error:
        yield failure("port", error.message, error.command_hint)
        return
    with opened_port:
        yield ok("port", f"{name} can be opened; no other program uses it")
        yield from _check_bus(opened_port, model, on_progress)


def _check_udev_rules(name: str) -> Iterator[Finding]:
    if not has_udev() or is_simulated(name) or "://" in name:
        return
    path = installed_rules()
    if path:
        yield ok("udev", f"{path} is installed")
        return
    yield warning(
        "udev",
        f"{RULES_FILE} is not installed; it gives access to adapters and lowers FTDI latency",
        _INSTALL,
    )


def _check_bus(port: Port, model: Model | None, on_progress: Progress | None) -> Iterator[Finding]:
    if model is None:
        found = _scan_with_progress(port, on_progress)
        shared_ids = [f.id for f in found if f.shares_id]
        if shared_ids:
            yield _duplicate_ids_finding(shared_ids)
        elif found:
            models = ", ".join(f"{f.model or 'unknown'} (id {f.id})" for f in found)
            yield ok("servos", f"{len(found)} answer at {found[0].baud_rate} baud: {models}")
            if arms := _arms_with(found):
                yield ok("arm", f"these are the servos of {', '.join(arms)}")
        else:
            yield failure("servos", "no servo answers at any baud rate", _NO_POWER)
        specs = [ServoSpec(f.id, f.table) for f in found if f.table and not f.shares_id]
    else:
        specs = servo_specs(model)
    bus = ServoBus(port, specs, retries=0)
    duplicates = find_duplicate_ids(bus) if model else []
    if duplicates:
        yield _duplicate_ids_finding(spec.id for spec in duplicates)
        specs = [spec for spec in specs if spec not in duplicates]
    present = [spec for spec in specs if model is None or _responds(bus, spec.id)]
    if model and specs:
        yield from _check_presence(port, specs, present, on_progress)
    if not present:
        return
    quality = measure_line_quality(
        bus,
        [s.id for s in present],
        READS,
        on_progress and (lambda count: on_progress("reading positions", count, READS)),
    )
    yield from _check_quality(quality, bus, find_adapter(port.name))
    yield from check_servos(ServoBus(port, present), model)


def _arms_with(found: Sequence[FoundServo]) -> list[str]:
    """Return the arms of the catalogue that have exactly these servos."""
    servos = {(each.id, each.table) for each in found}
    arms: list[str] = []
    for name in arm_names():
        with suppress(IkservoError):  # a damaged file, or an arm without servos
            if {(spec.id, spec.table) for spec in servo_specs(load_model(name))} == servos:
                arms.append(name)
    return arms


def _scan_with_progress(port: Port, on_progress: Progress | None) -> list[FoundServo]:
    return scan(
        port,
        on_step=on_progress
        and (lambda s: on_progress(f"{s.baud_rate} baud, {s.protocol}", s.pinged, s.ids)),
    )


def _duplicate_ids_finding(ids: Iterable[int]) -> Finding:
    listed = ", ".join(map(str, ids))
    return failure("servos", f"several servos share id {listed}", DUPLICATE_ID_HINT)


_NO_POWER = "Check that the servos' power supply is on and the cable is in the right socket."


def _responds(bus: ServoBus, servo_id: int) -> bool:
    for _ in range(3):
        try:
            bus.ping(servo_id)
        except BusError:
            continue
        return True
    return False


def _check_presence(
    port: Port,
    specs: Sequence[ServoSpec],
    present: Sequence[ServoSpec],
    on_progress: Progress | None,
) -> Iterator[Finding]:
    silent = [spec for spec in specs if spec not in present]
    if not silent:
        yield ok("servos", f"all {len(specs)} answer at {port.baudrate} baud")
    elif present:
        names = ", ".join(map(str, silent))
        hint = silence_hint(specs, [s.id for s in present], [s.id for s in silent])
        yield failure("servos", f"no answer from {names}", line_hint(port.name, hint))
    else:
        rate = port.baudrate
        found = _scan_with_progress(port, on_progress)
        port.setBaudRate(rate)
        if found:
            listed = "; ".join(map(str, found))
            yield failure(
                "servos",
                f"none of this arm's servos answers; on the bus: {listed}",
                "If it is another arm, choose it with --arm. "
                "If the servos are new: ikservo setup ARM",
            )
        else:
            text = f"no servo answers, at {rate} baud or any other"
            yield failure("servos", text, _NO_POWER)


def _check_quality(
    quality: LineQuality, bus: ServoBus, adapter: SerialAdapter | None
) -> Iterator[Finding]:
    if quality.round_trips_s:
        median_s, late_s = quality.round_trip_s(0.5), quality.round_trip_s(0.99)
        text = f"a read takes {1000 * median_s:.2f} ms (median), {1000 * late_s:.2f} ms (p99)"
        if median_s < _SLOW_S:
            yield ok("latency", text)
        else:
            ftdi = adapter is not None and adapter.vid == 0x0403
            buffering = "The FTDI chip buffers bytes; install the udev rule"
            cause = buffering if ftdi else "The adapter is slow"
            hint = f"{cause}; set the servos' return delay to 0: ikservo setup ARM"
            yield warning("latency", text, hint)
    lost = sum(quality.lost.values())
    text = f"{lost} of {quality.reads} reads lost"
    if not lost:
        yield ok("loss", text)
        return
    counts = ", ".join(f"{bus.servos[i]}: {count}" for i, count in quality.lost.items())
    kind = failure if quality.lost_fraction > _MAX_LOSS_FRACTION else warning
    hint = "Check for loose connectors, a weak supply or long cables."
    yield kind("loss", f"{text} ({counts})", line_hint(bus.port.name, hint))
