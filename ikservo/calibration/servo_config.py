"""The EEPROM registers on which a calibration relies: expected values and differences."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from ikservo.calibration.homing import MAX_X_OFFSET
from ikservo.calibration.records import CalibratedServo, Calibration
from ikservo.errors import CalibrationError
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.eeprom import firmware_version
from ikservo.registers import (
    ControlTable,
    Family,
    FeetechMode,
    OperatingMode,
    Register,
    RegisterName,
)

_ROLES = (
    RegisterName.HOMING_OFFSET,
    RegisterName.OPERATING_MODE,
    RegisterName.MIN_POSITION_LIMIT,
    RegisterName.MAX_POSITION_LIMIT,
)
_NAMES = {Family.FEETECH_STS: "phase", Family.DYNAMIXEL_2: "drive_mode"}
# Bits that reverse or shift the tick count; the other bits of these registers are for tuning.
_BITS = {"phase": 0b1001_0001, "drive_mode": 0b0001}

MULTI_TURN_BIT = 0b0001_0000  # a bit of phase: a multi-turn STS loses its count without power
EXTENDED, CURRENT_POSITION = OperatingMode.EXTENDED_POSITION, OperatingMode.CURRENT_BASED_POSITION
_MULTI_TURN_MODES = (EXTENDED, CURRENT_POSITION)


@dataclass(frozen=True, slots=True)
class ServoConfig:
    """The configuration of a servo.

    Attributes:
        id: The bus id.
        table: The control table.
        firmware: The firmware version; empty if the servo does not report it.
        registers: Raw numbers, by name, of the registers on which a calibration depends.
    """

    id: int
    table: type[ControlTable]
    firmware: str
    registers: Mapping[str, int]

    @property
    def offset(self) -> int:
        """The effective homing offset."""
        offset = self.registers.get("homing_offset", 0)
        one_turn = self.registers.get("operating_mode") == OperatingMode.POSITION
        ignored = one_turn and abs(offset) > MAX_X_OFFSET
        return 0 if self.table.family is Family.DYNAMIXEL_2 and ignored else offset

    @property
    def is_multi_turn(self) -> bool:
        """Whether the servo counts beyond one revolution."""
        return is_multi_turn(self.registers)


def same_direction(config: ServoConfig, held: Mapping[str, int]) -> bool:
    """Check whether a servo is in a position mode and counts in the direction of ``held``.

    An offset that the servo ignores also makes the result False.
    """
    mode = config.registers.get("operating_mode")
    turned = (name for name in _BITS if name in held and name in config.registers)
    if any(registers_differ(name, held[name], config.registers[name]) for name in turned):
        return False
    ignored = config.offset != config.registers.get("homing_offset", 0)
    return not ignored and mode in (config.table.position_modes or (mode,))


def is_multi_turn(held: Mapping[str, int]) -> bool:
    """Check whether a servo with these registers counts beyond one revolution."""
    dynamixel = "drive_mode" in held
    return dynamixel and held["operating_mode"] in _MULTI_TURN_MODES


def calibration_registers(table: type[ControlTable]) -> list[Register]:
    """Return the registers of a model on which a calibration depends."""
    roles = [table.find(role) for role in _ROLES if role not in table.missing]
    own = table.registers.get(_NAMES.get(table.family, ""))
    return [*roles, own] if own else roles


def read_servo_config(bus: ServoBus, servo_id: int) -> ServoConfig:
    """Read the configuration of a servo.

    Raises:
        BusError: The servo does not reply.
    """
    table = bus.servos[servo_id].table
    rows = calibration_registers(table)
    numbers = bus.sync_read_many([servo_id], rows, raw=True).require_all()[servo_id]
    held = {register.name: numbers[register] for register in rows}
    return ServoConfig(servo_id, table, firmware_version(bus, servo_id), held)


def registers_differ(register: str, one: int, other: int) -> bool:
    """Check whether two raw numbers of a register differ in the bits that matter."""
    return bool((one ^ other) & _BITS.get(register, -1))


def expected_registers(
    config: ServoConfig, offset: int, limits: tuple[int, int] | None, *, extended: bool
) -> dict[str, int]:
    """Compute the expected registers of a servo.

    Values of ``config`` are kept if possible. If no limits are given, the present limits are kept
    if they still correspond to the same positions, and set to the full range otherwise. An
    ``extended`` servo must count several turns.
    """
    held = dict(config.registers)
    if config.table.family is Family.FEETECH_STS:
        held["operating_mode"] = FeetechMode.POSITION
        held["phase"] &= ~MULTI_TURN_BIT
    elif "drive_mode" in held and held["operating_mode"] != CURRENT_POSITION:
        # A compliant gripper keeps its mode, which counts like the extended mode.
        held["operating_mode"] = EXTENDED if extended else OperatingMode.POSITION
    if "homing_offset" in held:
        held["homing_offset"] = offset
    names = (RegisterName.MIN_POSITION_LIMIT, RegisterName.MAX_POSITION_LIMIT)
    rows = [config.table.find(name) for name in names]
    moved = held.get("homing_offset") != config.registers.get("homing_offset")
    none_set = config.registers[rows[0].name] == config.registers[rows[1].name] == 0
    if limits is not None or moved or none_set:
        wide = (rows[0].range[0], rows[1].range[1])
        for row, tick in zip(rows, limits or wide, strict=True):
            held[row.name] = min(row.range[1], max(row.range[0], tick))
    return held


@dataclass(frozen=True, slots=True)
class RegisterMismatch:
    """A register that differs from its value when the arm was calibrated.

    If the register is ``model``, the servo itself is of a different model.
    """

    joint: str
    servo_id: int
    register: str
    expected: str
    found: str

    def __str__(self) -> str:
        return (
            f"{self.register} of {self.joint} (id {self.servo_id}) is {self.found} in the servo "
            f"and {self.expected} in the calibration"
        )


def register_mismatches(
    calibration: Calibration, config: Mapping[int, ServoConfig]
) -> Iterator[RegisterMismatch]:
    """Yield the differences between servos and a calibration, joint by joint."""
    for joint in calibration.joints:
        for servo in joint.servos:
            if servo.id not in config:
                yield RegisterMismatch(joint.name, servo.id, "id", str(servo.id), "absent")
            else:
                yield from _servo_mismatches(joint.name, servo, config[servo.id])


def _servo_mismatches(
    joint: str, servo: CalibratedServo, config: ServoConfig
) -> Iterator[RegisterMismatch]:
    if servo.model != config.table.model_name:
        yield RegisterMismatch(joint, servo.id, "model", servo.model, config.table.model_name)
        return
    for name, expected in servo.holds.items():
        found = config.registers.get(name)
        if found is None:
            yield RegisterMismatch(joint, servo.id, name, str(expected), "unknown")
        elif registers_differ(name, expected, found):
            yield RegisterMismatch(joint, servo.id, name, str(expected), str(found))


def raise_on_mismatch(contradictions: Iterable[RegisterMismatch]) -> None:
    """Check that there are no mismatches.

    Raises:
        CalibrationError: Registers differ; the error gives the first with both values, and the
            remedy.
    """
    first, *more = [*contradictions, None]
    if first is None:
        return
    rest = f", and {len(more) - 1} more" if len(more) > 1 else ""
    raise CalibrationError(
        f"{first}{rest}.",
        "See all: ikservo calibration diff. Write the file's values into the servos: "
        "ikservo calibration push. Measure again: ikservo calibrate",
    )
