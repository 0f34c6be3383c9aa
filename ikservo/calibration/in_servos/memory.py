"""What of a servo's EEPROM a calibration rests on, what it holds and what it should hold."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ikservo.calibration.sweeping.homing import X_MOST, Homing
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.finding.identify import firmware_of
from ikservo.registers import (
    Family,
    FeetechMode,
    OperatingMode,
    Register,
    Role,
    ServoTable,
)

__all__ = [
    "ServoFacts",
    "counts_alike",
    "counts_on",
    "differs",
    "facts_of",
    "held_registers",
    "wanted_memory",
]

_ROLES = (
    Role.HOMING_OFFSET,
    Role.OPERATING_MODE,
    Role.MIN_POSITION_LIMIT,
    Role.MAX_POSITION_LIMIT,
)
_NAMED = {Family.FEETECH_STS: ("phase",), Family.DYNAMIXEL_2: ("drive_mode",)}
# Bits that turn the count or its direction; the others of these registers are tuning.
_BITS = {"phase": 0b1001_0001, "drive_mode": 0b0001}

TURNS_BIT = 0b0001_0000  # of phase: an STS that counts several turns forgets them with the power
_POSITION_MODES = {
    Family.FEETECH_STS: (FeetechMode.POSITION,),
    Family.DYNAMIXEL_2: (
        OperatingMode.POSITION,
        OperatingMode.EXTENDED_POSITION,
        OperatingMode.CURRENT_BASED_POSITION,
    ),
}
EXTENDED, CURRENT_POSITION = OperatingMode.EXTENDED_POSITION, OperatingMode.CURRENT_BASED_POSITION
_MULTI_TURN_MODES = (EXTENDED, CURRENT_POSITION)


@dataclass(frozen=True, slots=True)
class ServoFacts:
    """A servo as it was found.

    Attributes:
        id: Its bus id.
        table: Its control table.
        firmware: What it says, in words; empty where it does not.
        held: Raw numbers of the registers that a calibration rests on, by name.
    """

    id: int
    table: type[ServoTable]
    firmware: str
    held: Mapping[str, int]

    @property
    def offset(self) -> int:
        """Return the homing offset that is in force."""
        offset = self.held.get("homing_offset", 0)
        one_turn = self.held.get("operating_mode") == OperatingMode.POSITION
        ignored = one_turn and abs(offset) > X_MOST
        return 0 if self.table.family is Family.DYNAMIXEL_2 and ignored else offset

    @property
    def counts_on(self) -> bool:
        """Return whether the servo counts on beyond one turn."""
        return counts_on(self.held)


def counts_alike(facts: ServoFacts, held: Mapping[str, int]) -> bool:
    """Return whether a servo counts in the direction that ``held`` says, and goes to positions.

    An offset that the servo ignores counts as no offset that could be relied on, either.
    """
    mode = facts.held.get("operating_mode")
    turned = (name for name in _BITS if name in held and name in facts.held)
    if any(differs(name, held[name], facts.held[name]) for name in turned):
        return False
    ignored = facts.offset != facts.held.get("homing_offset", 0)
    return not ignored and mode in _POSITION_MODES.get(facts.table.family, (mode,))


def counts_on(held: Mapping[str, int]) -> bool:
    """Return whether a servo that holds these numbers counts on beyond one turn."""
    dynamixel = "drive_mode" in held
    return dynamixel and held["operating_mode"] in _MULTI_TURN_MODES


def held_registers(table: type[ServoTable]) -> list[Register]:
    """Return the registers of a model that a calibration rests on."""
    roles = [table.find(role) for role in _ROLES if role not in table.lacks]
    return [*roles, *(table.registers[name] for name in _NAMED.get(table.family, ()))]


def facts_of(bus: ServoBus, servo_id: int) -> ServoFacts:
    """Return a servo as it is.

    Raises:
        BusError: It does not answer.
    """
    table = bus.servos[servo_id].table
    rows = held_registers(table)
    numbers = bus.sync_read_many([servo_id], rows, raw=True).complete()[servo_id]
    held = {register.name: numbers[register] for register in rows}
    return ServoFacts(servo_id, table, firmware_of(bus, servo_id), held)


def differs(register: str, one: int, other: int) -> bool:
    """Return whether two raw numbers of a register mean another count or limit."""
    return bool((one ^ other) & _BITS.get(register, -1))


def wanted_memory(
    facts: ServoFacts, homing: Homing, limits: tuple[int, int] | None
) -> dict[str, int]:
    """Return what a servo should hold.

    Args:
        facts: As it is; what need not change does not.
        homing: How its count shall be set up.
        limits: Position limits, raw; None leaves them open where the present ones no longer mean
            the same places, and as they are where they do.
    """
    held = dict(facts.held)
    if facts.table.family is Family.FEETECH_STS:
        held["operating_mode"] = FeetechMode.POSITION
        held["phase"] &= ~TURNS_BIT
    elif facts.table.family is Family.DYNAMIXEL_2:
        held["operating_mode"] = _x_mode(held["operating_mode"], homing)
    if "homing_offset" in held:
        held["homing_offset"] = homing.offset
    return held | _limits(facts, held, limits)


def _x_mode(mode: int, homing: Homing) -> int:
    if mode == OperatingMode.CURRENT_BASED_POSITION:
        return mode  # a gripper that yields; it counts on like the extended mode
    return OperatingMode.EXTENDED_POSITION if homing.extended else OperatingMode.POSITION


def _limits(
    facts: ServoFacts, held: Mapping[str, int], limits: tuple[int, int] | None
) -> dict[str, int]:
    rows = [facts.table.find(r) for r in (Role.MIN_POSITION_LIMIT, Role.MAX_POSITION_LIMIT)]
    moved = held.get("homing_offset") != facts.held.get("homing_offset")
    none_set = facts.held[rows[0].name] == facts.held[rows[1].name] == 0
    if limits is None and not (moved or none_set):
        return {}
    wide = (rows[0].range[0], rows[1].range[1])
    pairs = zip(rows, limits or wide, strict=True)
    return {row.name: min(row.range[1], max(row.range[0], tick)) for row, tick in pairs}
