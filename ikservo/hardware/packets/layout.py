"""Which numbers stand where in a servo's answer: worked out once, then read every cycle."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from struct import Struct
from typing import Any

from ikservo.hardware.packets.notation import Wanted
from ikservo.hardware.servo import ServoSpec
from ikservo.registers import Register, Role, TwosComplement, Unsigned

__all__ = ["Layout", "is_telling"]

_LETTERS = {1: "B", 2: "H", 4: "I"}


class Layout:
    """How one servo's wanted registers stand in the bytes of one answer.

    Args:
        servo: Whose they are.
        wanted: Its own register for each key of the caller.
        run: Those of one answer, by address; it begins with the first and ends with the last.

    Attributes:
        registers: The register behind each key.
        telling: Those of them that say something about torque or alarms.
    """

    def __init__(
        self, servo: ServoSpec, wanted: Mapping[Wanted, Register], run: Sequence[Register]
    ) -> None:
        self.registers = {key: register for key, register in wanted.items() if register in run}
        self.telling = {k: r for k, r in self.registers.items() if is_telling(servo, r)}
        self._places = [(key, run.index(register)) for key, register in self.registers.items()]
        self._unpack = Struct(_format(run)).unpack
        self._coded = [(at, register) for at, register in enumerate(run) if _is_coded(register)]

    def numbers(self, block: bytes) -> dict[Any, int]:
        """Return the raw number of each key in an answer."""
        words = list(self._unpack(block))
        for at, register in self._coded:
            words[at] = register.codec.to_number(words[at], register.size)
        return {key: words[at] for key, at in self._places}


def is_telling(servo: ServoSpec, register: Register) -> bool:
    """Return whether a register says something about torque or alarms."""
    table = servo.table
    if register is table.torque_enable:
        return True
    return Role.ALARMS not in table.lacks and register is table.alarms


def _format(run: Sequence[Register]) -> str:
    """Return what ``struct`` calls these registers; the bytes between them are passed over."""
    at, letters = run[0].address, ">" if run[0].byte_order == "big" else "<"
    for register in run:
        letter = _LETTERS[register.size]
        signed = isinstance(register.codec, TwosComplement)
        letters += f"{register.address - at}x{letter.lower() if signed else letter}"
        at = register.end
    return letters


def _is_coded(register: Register) -> bool:
    """Return whether a number is written in a way that ``struct`` does not know."""
    return not isinstance(register.codec, Unsigned | TwosComplement)
