"""Check single servos and their EEPROM."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence

from ikservo.apps.workbench.findings import Finding, failure, ok, warning
from ikservo.apps.workbench.tried_values import read_former, restore_former, tried_differences
from ikservo.calibration.calibration_file import load_calibration
from ikservo.calibration.servo_config import calibration_registers
from ikservo.errors import BusError, FileFormatError, UnknownNameError
from ikservo.guard import alarm_hint
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.eeprom import (
    RegisterDifference,
    eeprom_registers,
    firmware_version,
    register_differences,
    update_eeprom,
)
from ikservo.hardware.port_names import serial_number_of
from ikservo.hardware.register_batches import RegisterRef
from ikservo.hardware.servo import ServoSpec
from ikservo.model import Model, ModelServo
from ikservo.model.arm_model import HealthLimits
from ikservo.registers import Alarm, RegisterName, control_table_for_number

_CALIBRATED_REGISTERS = {
    "homing_offset",
    "min_position_limit",
    "max_position_limit",
}  # a calibration of this arm may have set them


def check_eeprom(bus: ServoBus, model: Model) -> Iterator[Finding]:
    """Compare the servos' EEPROM with the arm file."""
    calibrated = _has_calibrated_registers(bus, model)
    compared, matching = 0, True
    for own in all_servos(model):
        if own.id not in bus.servos or not own.eeprom:
            continue
        compared += len(own.eeprom)
        servo = bus.servos[own.id]
        try:
            expected = _expected_registers(servo, own, calibrated)
            differences = register_differences(bus, own.id, expected)
        except (BusError, UnknownNameError) as error:
            matching = False
            yield failure("eeprom", f"{servo}: {error.message}", error.command_hint)
            continue
        for one in differences:
            matching = False
            kind = warning if one.register.name in _CALIBRATED_REGISTERS else failure
            yield kind(
                "eeprom",
                f"{servo}: {one.register} is {one.found}, {one.expected} in the arm file",
                "Write the values from the arm file: ikservo doctor --write-eeprom",
            )
    if compared and matching:
        yield ok("eeprom", f"{compared} values match the arm file")


def _has_calibrated_registers(bus: ServoBus, model: Model) -> bool:
    """Check whether a calibration of this arm has set any of the registers."""
    try:
        return load_calibration(model.name, serial_number_of(bus.port.name)) is not None
    except FileFormatError:
        return True  # a malformed calibration counts, too


def _expected_registers(
    servo: ServoSpec, own: ModelServo, calibrated: bool
) -> dict[RegisterRef, int]:
    """Return the arm file's raw values, without the registers that a calibration has set."""
    registers = servo.table.registers
    unknown = [name for name in own.eeprom if name not in registers]
    if unknown:
        raise UnknownNameError(f"{servo.table.model_name} register", unknown[0], registers)
    expected = {registers[name]: number for name, number in own.eeprom.items()}
    kept = calibration_registers(servo.table) if calibrated else ()
    return {register: number for register, number in expected.items() if register not in kept}


def all_servos(model: Model) -> list[ModelServo]:
    """List every servo of the arm file; a joint's first servo comes before its other servos."""
    return [servo for joint in model.joints for servo in (joint.servo, *joint.shadows)]


def write_eeprom(bus: ServoBus, model: Model) -> dict[ServoSpec, list[RegisterDifference]]:
    """Write the arm file's EEPROM values and a zero return delay; return the changes.

    Registers that a calibration of this arm has set are not written. Trial values that a killed
    program has left are replaced by the former values.

    Raises:
        FileFormatError: The file of former values of a servo is damaged; nothing is written.
        RegisterAccessError: A servo's torque is on, or a value is out of range; the servos before
            it are written.
        ServoRejectedError: A value was not kept.
        BusError: A servo does not answer.
        FileWriteError: A servo's former values cannot be saved; the servos before it are written.
    """
    changed: dict[ServoSpec, list[RegisterDifference]] = {}
    calibrated = _has_calibrated_registers(bus, model)
    for own in all_servos(model):
        read_former(bus, bus.servos[own.id])
    for own in all_servos(model):
        servo = bus.servos[own.id]
        changes, expected = restore_former(bus, servo), _expected_registers(servo, own, calibrated)
        if RegisterName.RETURN_DELAY not in servo.table.missing:
            expected.setdefault(servo.table.return_delay, 0)
        changes += update_eeprom(bus, own.id, expected)
        if changes:
            changed[servo] = changes
    return changed


_USUAL_HEALTH = HealthLimits()
_LONG_DELAY_S = 1e-4  # sum over all servos


def check_servos(bus: ServoBus, model: Model | None) -> Iterator[Finding]:
    """Check the servos that reply, without changes; without a model, check each only by itself."""
    limits = model.health if model else _USUAL_HEALTH
    wrong_supply = set[int]()
    checks: dict[str, Callable[[], Iterator[Finding]]] = {
        "models": lambda: _check_models(bus),
        "supply": lambda: _check_supply(bus, wrong_supply),
        "heat": lambda: _check_temperature(bus, limits),
        "firmware": lambda: _check_firmware(bus),
        "alarms": lambda: _check_alarms(bus, wrong_supply),
        "delay": lambda: _check_return_delay(bus),
        "lock": lambda: _check_locks(bus),
        "trial": lambda: _check_trials(bus),
    }
    for name, check in checks.items():
        try:
            yield from check()
        except BusError as error:
            yield failure(name, error.message, error.command_hint)
    if model:
        yield from check_eeprom(bus, model)


def _check_models(bus: ServoBus) -> Iterator[Finding]:
    numbers = bus.sync_read(bus.servos, RegisterName.MODEL_NUMBER, raw=True).require_all()
    wrong = [s for s in bus.servos.values() if numbers[s.id] != s.table.number]
    for servo in wrong:
        other = control_table_for_number(servo.table.family, numbers[servo.id])
        name = other.model_name if other else f"servo of unknown model {numbers[servo.id]}"
        yield failure(
            "models",
            f"{servo} is a {name}, not a {servo.table.model_name}",
            "Is this another arm? Choose it with --arm. Otherwise two ids may be swapped.",
        )
    if not wrong:
        counts = Counter(s.table.model_name for s in bus.servos.values())
        yield ok("models", ", ".join(f"{count} {name}" for name, count in counts.items()))


def _check_supply(bus: ServoBus, wrong: set[int]) -> Iterator[Finding]:
    """Check the supply, and add the ids of servos with a wrong supply to ``wrong``."""
    names = (
        RegisterName.PRESENT_VOLTAGE,
        RegisterName.MIN_VOLTAGE_LIMIT,
        RegisterName.MAX_VOLTAGE_LIMIT,
    )
    rows = bus.sync_read_many(bus.servos, names).require_all()
    outside: dict[tuple[float, float], dict[int, float]] = defaultdict(dict)
    for servo_id, row in rows.items():
        volts, lower, upper = (row[name] for name in names)
        if not lower <= volts <= upper:
            outside[lower, upper][servo_id] = volts
            wrong.add(servo_id)
    for (lower, upper), volts_by_id in outside.items():
        yield failure(
            "supply",
            f"{_format_servos(bus, volts_by_id)} {'has' if len(volts_by_id) == 1 else 'have'} a "
            f"supply voltage of {_format_range(volts_by_id.values(), '.1f')} V; "
            f"the allowed range is {lower:.1f} to {upper:.1f} V",
            "Check that the power supply is the right one; torque cannot be switched on.",
        )
    if not outside:
        volts = [row[RegisterName.PRESENT_VOLTAGE] for row in rows.values()]
        yield ok("supply", f"{_format_range(volts, '.1f')} V, inside every servo's limits")


def _check_temperature(bus: ServoBus, limits: HealthLimits) -> Iterator[Finding]:
    degrees = bus.sync_read(bus.servos, RegisterName.PRESENT_TEMPERATURE).require_all()
    cool = True
    for servo_id, celsius in degrees.items():
        if celsius >= limits.warn_c:
            cool = False
            kind = failure if celsius >= limits.hold_c else warning
            yield kind(
                "heat", f"{bus.servos[servo_id]} is at {celsius:.0f} °C", "Let it cool down."
            )
    if cool:
        yield ok("heat", f"{_format_range(degrees.values(), '.0f')} °C")


def _check_firmware(bus: ServoBus) -> Iterator[Finding]:
    versions: dict[str, dict[str, list[ServoSpec]]] = defaultdict(lambda: defaultdict(list))
    for servo in bus.servos.values():
        versions[servo.table.model_name][firmware_version(bus, servo.id)].append(servo)
    for name, groups in versions.items():
        if len(groups) > 1:
            ordered = sorted(groups, key=lambda version: list(map(int, version.split("."))))
            text = "; ".join(f"{each}: {', '.join(map(str, groups[each]))}" for each in ordered)
            apart = _settings_apart(bus, [groups[each] for each in ordered])
            yield warning(
                "firmware",
                f"{name} servos differ: {text}; stored settings: {apart or 'the same'}",
                "You may go on, but LeRobot may refuse this. If one moves differently, update all "
                f"to {ordered[-1]} or newer with the vendor's tool (FD, Dynamixel Wizard).",
            )
    if all(len(groups) == 1 for groups in versions.values()):
        texts = [f"{name} {next(iter(groups))}" for name, groups in versions.items()]
        yield ok("firmware", ", ".join(texts))


def _settings_apart(bus: ServoBus, groups: Sequence[Sequence[ServoSpec]]) -> str:
    """List the EEPROM settings that are equal within each group of servos but not across groups."""
    table = groups[0][0].table
    kept = {table.id.name, *_CALIBRATED_REGISTERS}
    rows = [r for r in eeprom_registers(table) if r.is_writable and r.name not in kept]
    ids = [servo.id for group in groups for servo in group]
    held = bus.sync_read_many(ids, rows, raw=True).require_all()
    apart: list[str] = []
    for register in rows:
        own = [{held[servo.id][register] for servo in group} for group in groups]
        numbers = [next(iter(each)) for each in own if len(each) == 1]
        if len(numbers) == len(own) and len(set(numbers)) > 1:
            apart.append(f"{register} {' / '.join(map(str, numbers))}")
    return ", ".join(apart)


def _check_alarms(bus: ServoBus, wrong_supply: Collection[int]) -> Iterator[Finding]:
    """Check alarms, except voltage alarms of servos whose supply was already reported."""
    known = frozenset({Alarm.VOLTAGE})
    alarms_by_id = {
        i: frozenset(bus.read_alarms(i)) - (known if i in wrong_supply else frozenset())
        for i in bus.servos
    }
    for alarms in dict.fromkeys(filter(None, alarms_by_id.values())):
        text = ", ".join(sorted(str(alarm) for alarm in alarms))
        alike = [i for i, own in alarms_by_id.items() if own == alarms]
        yield failure("alarms", f"{_format_servos(bus, alike)}: {text}", alarm_hint(alarms))
    if not any(alarms_by_id.values()):
        yield ok("alarms", "none")


def _check_return_delay(bus: ServoBus) -> Iterator[Finding]:
    ids = [i for i, s in bus.servos.items() if RegisterName.RETURN_DELAY not in s.table.missing]
    if not ids:
        return
    delays_s = bus.sync_read(ids, RegisterName.RETURN_DELAY).require_all()
    total_s = sum(delays_s.values())
    if total_s <= _LONG_DELAY_S:
        yield ok("delay", "servos answer without delay")
        return
    late = ", ".join(str(bus.servos[i]) for i, delay_s in delays_s.items() if delay_s)
    yield warning(
        "delay",
        f"return delays take {1000 * total_s:.1f} ms per cycle ({late})",
        "Set them to 0: ikservo doctor --write-eeprom, or ikservo setup ARM",
    )


def _check_locks(bus: ServoBus) -> Iterator[Finding]:
    locks = {i: servo.table.eeprom_lock for i, servo in bus.servos.items()}
    unlocked = [i for i, lock in locks.items() if lock and not bus.read(i, lock, raw=True)]
    if unlocked:
        yield warning(
            "lock",
            f"{_format_servos(bus, unlocked)} "
            f"{'has its' if len(unlocked) == 1 else 'have their'} EEPROM unlocked",
            "Every write wears out the EEPROM; lock it again: ikservo doctor --write-eeprom",
        )


def _check_trials(bus: ServoBus) -> Iterator[Finding]:
    for servo in bus.servos.values():
        try:
            left = tried_differences(bus, servo)
        except FileFormatError as error:
            yield failure("trial", error.message, error.command_hint)
            continue
        if left:
            texts = (f"{each.register} {each.found}, not {each.expected}" for each in left)
            yield warning(
                "trial",
                f"{servo} still has the trial values of a program that was killed: "
                f"{', '.join(texts)}",
                "Switch its power off and on, or write the previous values: "
                "ikservo doctor --write-eeprom",
            )


def _format_servos(bus: ServoBus, servo_ids: Collection[int]) -> str:
    """Return a list of servos with a common cause, or their number if all are affected."""
    if len(servo_ids) == len(bus.servos) > 1:
        return f"all {len(servo_ids)} servos"
    return ", ".join(str(bus.servos[i]) for i in servo_ids)


def _format_range(values: Iterable[float], form: str) -> str:
    """Format values as ``11.9 to 12.1``, or as one number if all are equal."""
    ordered = sorted(values)
    ends = dict.fromkeys((f"{ordered[0]:{form}}", f"{ordered[-1]:{form}}"))
    return " to ".join(ends)
