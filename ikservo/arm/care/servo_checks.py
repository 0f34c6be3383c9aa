"""How the servos themselves are: model, supply, heat, firmware, alarms, and what EEPROM holds."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator

from ikservo.arm.care.eeprom_checks import check_eeprom
from ikservo.arm.care.findings import Finding, bad, good, odd
from ikservo.errors import BusError
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.finding.identify import firmware_of
from ikservo.hardware.servo import ServoSpec
from ikservo.model import Model
from ikservo.model.health import HealthLimits
from ikservo.registers import Role, table_with_number

__all__ = ["check_servos"]

_USUAL_HEALTH = HealthLimits()
_LONG_DELAY_S = 1e-4  # of all servos together


def check_servos(bus: ServoBus, model: Model | None) -> Iterator[Finding]:
    """Yield what is found about servos that answer; nothing is changed.

    Args:
        bus: The line, with those servos.
        model: The arm they should be, if one is meant.
    """
    limits = model.health if model else _USUAL_HEALTH
    checks: dict[str, Callable[[], Iterator[Finding]]] = {
        "models": lambda: _models(bus),
        "supply": lambda: _supply(bus),
        "heat": lambda: _heat(bus, limits),
        "firmware": lambda: _firmware(bus),
        "alarms": lambda: _alarms(bus),
        "delay": lambda: _return_delay(bus),
        "lock": lambda: _locks(bus),
    }
    for name, check in checks.items():
        try:
            yield from check()
        except BusError as error:
            yield bad(name, error.message, error.command_hint)
    if model:
        yield from check_eeprom(bus, model)


def _models(bus: ServoBus) -> Iterator[Finding]:
    numbers = bus.sync_read(bus.servos, Role.MODEL_NUMBER, raw=True).complete()
    wrong = [s for s in bus.servos.values() if numbers[s.id] != s.table.number]
    for servo in wrong:
        other = table_with_number(servo.table.family, numbers[servo.id])
        name = other.model_name if other else f"servo of unknown model {numbers[servo.id]}"
        yield bad(
            "models",
            f"{servo} is a {name}, not a {servo.table.model_name}",
            "Another arm (choose it with --arm), or two swapped ids.",
        )
    if not wrong:
        yield good("models", _counted(s.table.model_name for s in bus.servos.values()))


def _supply(bus: ServoBus) -> Iterator[Finding]:
    wanted = (Role.PRESENT_VOLTAGE, Role.MIN_VOLTAGE_LIMIT, Role.MAX_VOLTAGE_LIMIT)
    rows = bus.sync_read_many(bus.servos, wanted).complete()
    fed = True
    for servo in bus.servos.values():
        volts, lower, upper = (rows[servo.id][role] for role in wanted)
        if not lower <= volts <= upper:
            fed = False
            yield bad(
                "supply",
                f"{servo} has a supply of {volts:.1f} V; allowed are {lower:.1f} to {upper:.1f} V",
                "Check that the power supply is the right one; torque cannot be switched on.",
            )
    if fed:
        volts = [row[Role.PRESENT_VOLTAGE] for row in rows.values()]
        yield good("supply", f"{_span(volts, '.1f')} V, inside every servo's limits")


def _heat(bus: ServoBus, limits: HealthLimits) -> Iterator[Finding]:
    degrees = bus.sync_read(bus.servos, Role.PRESENT_TEMPERATURE).complete()
    cool = True
    for servo_id, celsius in degrees.items():
        if celsius >= limits.warn_c:
            cool = False
            kind = bad if celsius >= limits.hold_c else odd
            yield kind(
                "heat", f"{bus.servos[servo_id]} is at {celsius:.0f} °C", "Let it cool down."
            )
    if cool:
        yield good("heat", f"{_span(degrees.values(), '.0f')} °C")


def _firmware(bus: ServoBus) -> Iterator[Finding]:
    versions: dict[str, dict[str, list[ServoSpec]]] = defaultdict(lambda: defaultdict(list))
    for servo in bus.servos.values():
        versions[servo.table.model_name][firmware_of(bus, servo.id)].append(servo)
    for name, groups in versions.items():
        if len(groups) > 1:
            text = "; ".join(f"{v}: {', '.join(map(str, s))}" for v, s in sorted(groups.items()))
            yield odd(
                "firmware",
                f"{name} servos differ: {text}",
                "Bring all to the newest with the vendor's tool (FD, Dynamixel Wizard).",
            )
    if all(len(groups) == 1 for groups in versions.values()):
        texts = [f"{name} {next(iter(groups))}" for name, groups in versions.items()]
        yield good("firmware", ", ".join(texts))


def _alarms(bus: ServoBus) -> Iterator[Finding]:
    complaints = {i: bus.read_alarms(i) for i in bus.servos}
    for servo_id, alarms in complaints.items():
        if alarms:
            text = ", ".join(sorted(str(alarm) for alarm in alarms))
            yield bad(
                "alarms",
                f"{bus.servos[servo_id]}: {text}",
                "Remove the load, then: ikservo recover",
            )
    if not any(complaints.values()):
        yield good("alarms", "none")


def _return_delay(bus: ServoBus) -> Iterator[Finding]:
    ids = [i for i, s in bus.servos.items() if Role.RETURN_DELAY not in s.table.lacks]
    if not ids:
        return
    delays_s = bus.sync_read(ids, Role.RETURN_DELAY).complete()
    total_s = sum(delays_s.values())
    if total_s <= _LONG_DELAY_S:
        yield good("delay", "servos answer without delay")
        return
    late = ", ".join(str(bus.servos[i]) for i, delay_s in delays_s.items() if delay_s)
    yield odd(
        "delay",
        f"return delays take {1000 * total_s:.1f} ms in each round ({late})",
        "Set them to 0: ikservo doctor --write-eeprom, or ikservo setup ARM",
    )


def _locks(bus: ServoBus) -> Iterator[Finding]:
    for servo in bus.servos.values():
        lock = servo.table.eeprom_lock
        if lock and not bus.read(servo.id, lock, raw=True):
            yield odd(
                "lock",
                f"{servo} has its EEPROM unlocked",
                "Every write wears it; lock it again: ikservo doctor --write-eeprom",
            )


def _counted(names: Iterable[str]) -> str:
    counts = Counter(names)
    return ", ".join(f"{count} {name}" for name, count in counts.items())


def _span(values: Iterable[float], form: str) -> str:
    """Return ``11.9 to 12.1``, or one number where all are alike."""
    ordered = sorted(values)
    ends = dict.fromkeys((f"{ordered[0]:{form}}", f"{ordered[-1]:{form}}"))
    return " to ".join(ends)
