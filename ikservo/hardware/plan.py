"""A reading of many servos, thought through once and then carried out every cycle."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from ikservo.hardware.packets.block import rounds
from ikservo.hardware.packets.notation import Wanted, own_register
from ikservo.hardware.packets.span import Span
from ikservo.hardware.servo import ServoSpec
from ikservo.registers import Register, Role

__all__ = ["Cell", "Plan", "Round", "Slot", "is_telling", "plan_reading", "plan_writing"]


@dataclass(frozen=True, slots=True)
class Slot:
    """Where in a servo's answer a wanted number stands.

    Attributes:
        key: What the caller called it.
        register: The servo's own register.
        start: Its first byte in the answer.
        telling: It says something about torque or alarms that the bus remembers.
    """

    key: Wanted
    register: Register
    start: int
    telling: bool

    def number(self, block: bytes) -> int:
        """Return the raw number in an answer."""
        return self.register.decode(block[self.start : self.start + self.register.size])


@dataclass(frozen=True, slots=True)
class Round:
    """What can be asked at one time.

    Attributes:
        servos: Whom.
        spans: What memory, by id.
        slots: What is wanted of it, by id.
        asked: The same in words.
        steady: Nothing of it changes by itself.
    """

    servos: Sequence[ServoSpec]
    spans: Mapping[int, Span]
    slots: Mapping[int, Sequence[Slot]]
    asked: str
    steady: bool


@dataclass(frozen=True, slots=True)
class Plan:
    """All rounds of a reading, and whom it concerns."""

    servo_ids: Sequence[int]
    rounds: Sequence[Round]


@dataclass(frozen=True, slots=True)
class Cell:
    """One servo's own register of a writing.

    Attributes:
        telling: See ``is_telling``.
    """

    servo: ServoSpec
    register: Register
    telling: bool


def plan_writing(servos: Iterable[ServoSpec], wanted: Wanted) -> list[Cell]:
    """Return the servos' own registers for what is to be written.

    Raises:
        UnknownNameError: A servo has no such register.
    """
    own = [(servo, own_register(servo, wanted)) for servo in servos]
    return [Cell(servo, register, is_telling(servo, register)) for servo, register in own]


def plan_reading(wanted: Mapping[ServoSpec, Sequence[Wanted]]) -> Plan:
    """Return how to read of each servo its own registers.

    Raises:
        UnknownNameError: A servo has no such register.
    """
    own = {
        servo.id: {key: own_register(servo, key) for key in keys} for servo, keys in wanted.items()
    }
    servos = {servo.id: servo for servo in wanted}
    runs_of_rounds = rounds({i: registers.values() for i, registers in own.items()})
    return Plan(tuple(servos), [_round(servos, own, runs) for runs in runs_of_rounds])


def _round(
    servos: Mapping[int, ServoSpec],
    own: Mapping[int, Mapping[Wanted, Register]],
    runs: Mapping[int, Sequence[Register]],
) -> Round:
    first = next(iter(runs.values()))
    return Round(
        servos=[servos[i] for i in runs],
        spans={i: Span(run[0].address, run[-1].end - run[0].address) for i, run in runs.items()},
        slots={
            i: [_slot(servos[i], key, r, run) for key, r in own[i].items() if r in run]
            for i, run in runs.items()
        },
        asked=f"read {', '.join(register.name for register in first)}",
        steady=all(register.steady for run in runs.values() for register in run),
    )


def _slot(servo: ServoSpec, key: Wanted, register: Register, run: Sequence[Register]) -> Slot:
    return Slot(key, register, register.address - run[0].address, is_telling(servo, register))


def is_telling(servo: ServoSpec, register: Register) -> bool:
    """Return whether a register says something about torque or alarms."""
    table = servo.table
    if register is table.torque_enable:
        return True
    return Role.ALARMS not in table.lacks and register is table.alarms
