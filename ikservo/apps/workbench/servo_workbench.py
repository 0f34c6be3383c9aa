"""Find, read, write and reset registers of single servos, on an arm or alone on a line."""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Generator, Iterable, Mapping
from dataclasses import dataclass, replace

from ikservo.apps.workbench.id_and_baud_rate import change_address, check_address_is_free
from ikservo.apps.workbench.tried_values import forget_if_former
from ikservo.arguments import parse_port
from ikservo.arm.opening import backup_owner, open_bus
from ikservo.arm.stoppable_bus import stoppable
from ikservo.control.stop_requests import exiting_on_signals
from ikservo.errors import (
    BusError,
    FileFormatError,
    InputError,
    RegisterAccessError,
    ServoRejectedError,
    ServoSilentError,
    UnknownNameError,
)
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.eeprom import (
    RegisterDifference,
    back_up_once,
    backup_path,
    lock_eeprom,
    read_backup,
    refuse_under_torque,
    register_differences,
    update_eeprom,
)
from ikservo.hardware.port import Port, open_port
from ikservo.hardware.port_choice import choose_port, simulated_port_url
from ikservo.hardware.register_batches import encode_value
from ikservo.hardware.scan import (
    FoundServo,
    OnScanStep,
    candidate_baud_rates,
    firmware_version,
    scan,
    scan_servo,
)
from ikservo.hardware.servo import ServoSpec
from ikservo.hardware.torque import torque_on
from ikservo.maintenance.alarm_recovery import wait_for_boot
from ikservo.model import Model
from ikservo.registers import (
    MODELS,
    Area,
    ControlTable,
    Register,
    RegisterName,
)
from ikservo.registers.delivered import delivered_value


@dataclass(frozen=True, slots=True)
class ServoLine:
    """The servos on which a command works, and their bus."""

    bus: ServoBus

    def find(self, target: str | None) -> ServoSpec:
        """Find a servo by joint name or id; with None, return the only servo.

        Raises:
            UnknownNameError: There is no such servo.
            InputError: There are several servos.
        """
        servos = list(self.bus.servos.values())
        found = [each for each in servos if target in (None, each.name, str(each.id))]
        if not found:
            names = [each.name or str(each.id) for each in servos]
            raise UnknownNameError("servo", str(target), names)
        if len(found) > 1:
            ids = ", ".join(str(each.id) for each in found)
            raise InputError("It is not clear which servo is meant.", f"Name one by its id: {ids}.")
        return found[0]

    def with_ids(self, ids: Mapping[int, int]) -> ServoLine:
        """Return the line with the given ids instead of the ids in the arm file."""
        specs = [replace(each, id=ids.get(each.id, each.id)) for each in self.bus.servos.values()]
        bus = ServoBus(self.bus.port, specs)
        bus.backup_owner = self.bus.backup_owner
        return ServoLine(bus)


@contextlib.contextmanager
def open_servos(
    model: Model | None,
    port: str | None,
    *,
    servo_id: int | None = None,
    table: type[ControlTable] | None = None,
    baud_rate: int | None = None,
    on_step: OnScanStep | None = None,
) -> Generator[ServoLine]:
    """Open the servos of an arm, or all that reply on a line; signals wait for a running write.

    Without an arm, servos are searched for: at one id and baud rate, or at all known ones. Their
    table is ``table``, if given.

    Raises:
        InputError: A servo of an unknown model replies, or several servos share an id.
        ServoSilentError: No servo replies.
        PortError: There is no port, or it cannot be opened.
    """
    if model is not None:
        with exiting_on_signals(), open_bus(model, port) as bus:
            yield ServoLine(bus)
        return
    name = simulated_port_url(choose_port(parse_port(port)), None)
    with exiting_on_signals(), open_port(name, baud_rate or candidate_baud_rates()[0]) as line:
        rates = [baud_rate] if baud_rate else candidate_baud_rates()
        if servo_id is None:
            found = scan(line, rates, on_step=on_step)
        else:
            found = scan_servo(line, servo_id, rates)
        specs = [_spec_of(servo, table) for servo in found]
        if not specs:
            tried = "every known rate" if baud_rate is None else f"{baud_rate} baud"
            what = "has no servo" if servo_id is None else f"has no servo with id {servo_id}"
            raise ServoSilentError(
                f"{what} that replies at {tried}",
                "Check the plug and the power supply.",
                port=line.name,
            )
        with stoppable(ServoBus(line, specs)) as bus:
            bus.backup_owner = backup_owner(line.name)
            yield ServoLine(bus)


def _spec_of(found: FoundServo, table: type[ControlTable] | None) -> ServoSpec:
    if found.shares_id:
        raise InputError(
            f"Several servos answer at id {found.id}.",
            "Connect one at a time and give each its own id: ikservo setup ARM",
        )
    known = table or found.table
    if known is None:
        raise InputError(
            f"The registers of this servo are unknown: {found}.",
            "Give a known model with the same registers: --model",
        )
    return ServoSpec(found.id, known)


_SHOWN_UNITS = {  # by the register's unit: the shown unit, and the factor to it
    "rad": ("°", math.degrees(1)),
    "rad/s": ("°/s", math.degrees(1)),
    "rad/s²": ("°/s²", math.degrees(1)),
    "1": ("%", 100.0),
}


def shown_unit(register: Register) -> tuple[str, float]:
    """Return the unit in which a register is shown, and the conversion factor to it."""
    symbol = register.unit.symbol
    return _SHOWN_UNITS.get(symbol, (symbol, 1.0))


@dataclass(frozen=True, slots=True)
class RegisterReading:
    """A register and its value.

    Attributes:
        register: The register.
        raw: The raw number in the register.
        first: The raw number in the servo's first copy, made before ikservo changed anything; None
            without a copy.
        default: The raw number as delivered, according to the data sheet; None if unknown.
    """

    register: Register
    raw: int
    first: int | None
    default: int | None

    @property
    def value(self) -> float:
        """The value in the register's unit."""
        return self.register.to_value(self.raw)

    @property
    def text(self) -> str:
        """The value with its unit, angles in degrees; empty for a plain number."""
        if not self.register.unit.symbol:
            return ""
        shown, factor = shown_unit(self.register)
        return f"{self.value * factor:.4g} {shown}"

    @property
    def changed(self) -> bool:
        """Whether the value differs from the first copy."""
        return self.first is not None and self.first != self.raw


def read_registers(
    line: ServoLine, servo: ServoSpec, names: Iterable[str] = ()
) -> list[RegisterReading]:
    """Read registers of a servo by the vendor's or the common names; all if none are named.

    Raises:
        UnknownNameError: The model has no such register.
        BusError: The servo does not reply.
    """
    registers = [find_register(servo.table, name) for name in names]
    wanted = registers or list(servo.table.registers.values())
    first: Mapping[str, int] = {}
    path = backup_path(line.bus.backup_owner, servo)
    with contextlib.suppress(FileFormatError, OSError):
        if path.exists():
            first = read_backup(path).eeprom
    raw = line.bus.sync_read_many([servo.id], wanted, raw=True).require_all()[servo.id]
    table = servo.table
    return [
        RegisterReading(each, raw[each], first.get(each.name), delivered_value(table, each))
        for each in wanted
    ]


def find_register(table: type[ControlTable], name: str) -> Register:
    """Find a register by the vendor's name, or by the common name of all families.

    Raises:
        UnknownNameError: The model has no such register.
    """
    if name not in table.registers and name in {each.value for each in RegisterName}:
        return table.find(RegisterName(name))
    if name not in table.registers:
        raise UnknownNameError(f"{table.model_name} register", name, table.registers)
    return table.registers[name]


def register_names(model_name: str | None) -> list[str]:
    """Return a model's register names, or the names of all known models if it is unknown."""
    tables = [MODELS[model_name]] if model_name and model_name in MODELS else MODELS.values()
    return sorted({name for table in tables for name in table.registers})


def identify_servo(line: ServoLine, servo: ServoSpec) -> tuple[int, str]:
    """Return the model number and the firmware version that a servo reports.

    Raises:
        BusError: The servo does not reply.
    """
    return line.bus.ping(servo.id).model_number, firmware_version(line.bus, servo.id)


def holds_torque(line: ServoLine, servo: ServoSpec) -> bool:
    """Read whether a servo's torque is on.

    Raises:
        BusError: The servo does not reply.
    """
    return line.bus.read(servo.id, RegisterName.TORQUE_ENABLE, raw=True) == 1


_UNITS = {  # by a unit that users may type: the register's unit, and the factor to it
    "deg": ("rad", math.radians(1)),
    "rad": ("rad", 1.0),
    "deg/s": ("rad/s", math.radians(1)),
    "rad/s": ("rad/s", 1.0),
    "rpm": ("rad/s", math.tau / 60),
    "deg/s2": ("rad/s²", math.radians(1)),
    "V": ("V", 1.0),
    "A": ("A", 1.0),
    "mA": ("A", 1e-3),
    "s": ("s", 1.0),
    "ms": ("s", 1e-3),
    "us": ("s", 1e-6),
    "C": ("°C", 1.0),
    "%": ("1", 0.01),
}


def parse_register_value(register: Register, text: str) -> int:
    """Parse a value: a plain integer is the raw number, a number with a unit is a quantity.

    Raises:
        InputError: The text is not a number, or the unit does not fit the register.
    """
    if re.fullmatch(r"[+-]?[0-9]{1,12}|0[xX][0-9a-fA-F]{1,9}", text):
        return int(text, 0) if "x" in text.lower() else int(text)
    match = re.fullmatch(r"([+-]?(?:[0-9]{1,12}\.?[0-9]*|\.[0-9]+)) ?(\S+)", text)
    symbol, size = _UNITS.get(match[2], ("", 0.0)) if match else ("", 0.0)
    if match is None or symbol != register.unit.symbol or not symbol:
        units = [name for name, (symbol, _) in _UNITS.items() if symbol == register.unit.symbol]
        listed = f", or a number with {' or '.join(units)}" if units else ""
        raise InputError(
            f"{text!r} is not a value of {register}.",
            f"Give the raw integer from the data sheet{listed}.",
        )
    return register.to_raw(float(match[1]) * size)


_REPLY_LEVELS = {"response_level": 1, "status_return_level": 2}  # least level with all replies
_HIGHEST_ID = 252


def plan_writes(
    line: ServoLine, servo: ServoSpec, values: Mapping[Register, int]
) -> list[RegisterDifference]:
    """Return the registers that would change; nothing is written.

    Raises:
        RegisterAccessError: A register is read-only, does not accept its number, is in EEPROM while
            torque is on, or is the EEPROM lock, which each write sets itself.
        BusError: The servo does not reply.
    """
    for register, raw in values.items():
        reason, name, hint = "", register.name, ""
        if register is servo.table.eeprom_lock and raw == 0:
            reason = "each write unlocks the EEPROM and locks it again"
        elif name in _REPLY_LEVELS and raw < _REPLY_LEVELS[name]:
            reason = f"at {raw} the servo would no longer reply to a write"
        elif name == "protocol_type" and raw != line.bus.read(servo.id, register, raw=True):
            reason = f"at {raw} the servo would no longer reply on this line"
        elif name == "secondary_id" and raw <= _HIGHEST_ID:
            reason = f"the servo would also obey the goals of servo {raw}"
        elif (name, raw) in servo.table.non_idempotent:
            reason, hint = f"{raw} would change the zero", "Calibrate instead: ikservo calibrate"
        if reason:
            raise RegisterAccessError(str(servo), name, reason, hint)
        encode_value(servo, register, raw, raw=True)
    changes = register_differences(line.bus, servo.id, {**values})
    stored = [each.register for each in changes if each.register.area is Area.EEPROM]
    if stored:
        refuse_under_torque(line.bus, servo.id, stored[0])
    return changes


def write_registers(
    line: ServoLine, servo: ServoSpec, changes: Iterable[RegisterDifference]
) -> None:
    """Make the first EEPROM copy, then write the planned changes and verify them.

    An EEPROM that a killed program has left unlocked is locked, even if nothing changes. Torque
    is switched on at the present position. Id and baud rate are written last, because the servo
    then replies at the new values.

    Raises:
        RegisterAccessError: Torque is on, or it is off and a goal is written.
        ServoRejectedError: A number was not stored.
        InputError: The new id belongs to another servo.
        BusError: The servo does not reply.
        StoppedError: Another program has stopped this program.
        FileWriteError: The copy cannot be written; nothing was changed.
    """
    bus, table = line.bus, servo.table
    new = {each.register: each.expected for each in changes}
    address = {register: new.pop(register) for register in (table.id, table.baud_rate)
               if register in new}  # fmt: skip
    forget_if_former(bus, servo, new)
    code = address.get(table.baud_rate)
    rate = bus.port.baudrate if code is None else table.baud_rates[code]
    if address:
        check_address_is_free(bus.port, servo, address.get(table.id, servo.id), rate)
    stored = {register: raw for register, raw in new.items() if register.area is Area.EEPROM}
    if address:
        back_up_once(bus, bus.backup_owner, [servo.id])
    if stored:
        update_eeprom(bus, servo.id, {**stored})
    else:
        lock_eeprom(bus, servo.id)
    for register, raw in new.items():
        if register in stored:
            continue
        bus.check_may_move()
        if register is table.torque_enable and raw:
            torque_on(bus, servo.id)
        else:
            bus.write(servo.id, register, raw, raw=True)
        _verify(bus, servo, register, raw)
    if address:
        change_address(bus.port, servo, address.get(table.id, servo.id), rate)


def _verify(bus: ServoBus, servo: ServoSpec, register: Register, raw: int) -> None:
    held = bus.read(servo.id, register, raw=True)
    if held != raw:
        raise ServoRejectedError(
            f"holds {register} = {held} after {raw} was written",
            servo=str(servo),
            servo_id=servo.id,
            port=bus.port.name,
        )


def restart_servo(line: ServoLine, servo: ServoSpec) -> None:
    """Restart a servo and wait until it replies; its torque is off unless a register keeps it on.

    Raises:
        BusError: The servo refused, its family does not support a restart, or it does not reply
            again.
    """
    line.bus.reboot(servo.id)
    wait_for_boot(line.bus, servo)


def reset_servo(line: ServoLine, servo: ServoSpec) -> None:
    """Make a copy, then reset a servo to its factory settings; it keeps its id and baud rate.

    Raises:
        BusError: The servo refused, its family would lose its id, or it does not reply again.
        FileWriteError: The copy cannot be written; nothing was changed.
    """
    back_up_once(line.bus, line.bus.backup_owner, [servo.id])
    port, rate = line.bus.port, line.bus.port.baudrate
    line.bus.factory_reset(servo.id)
    if not _replies_at(port, servo, rate):
        found = scan_servo(port, servo.id, candidate_baud_rates())
        if not found:
            raise ServoSilentError(
                "does not reply after the reset", "Switch its power off and on, then scan.",
                servo=str(servo), servo_id=servo.id, port=port.name,
            )  # fmt: skip
        change_address(port, servo, servo.id, rate)
    port.setBaudRate(rate)


def _replies_at(port: Port, servo: ServoSpec, rate: int) -> bool:
    port.setBaudRate(rate)
    try:
        wait_for_boot(ServoBus(port, [servo], retries=0), servo)
    except BusError:
        return False
    return True
