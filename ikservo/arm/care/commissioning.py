"""A box of servos becomes the servos of an arm: one after the other, each alone on the line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from ikservo.arm.line import chosen_port
from ikservo.errors import IkservoError, UnknownNameError
from ikservo.hardware.finding.identify import Found
from ikservo.hardware.keeping.provisioning import Wish, check_model, provision
from ikservo.hardware.line.plugging import await_none, await_one
from ikservo.hardware.line.port import Port, open_port
from ikservo.hardware.servo import ServoSpec
from ikservo.model import Model
from ikservo.registers import table_for

__all__ = ["Helper", "Settled", "Wish", "commission", "wishes"]


@dataclass(frozen=True, slots=True)
class Settled:
    """A servo that is what it shall be.

    Attributes:
        servo: Its id, table and joint.
        found: As it was.
        written: What was changed, in words; nothing where all was right.
    """

    servo: ServoSpec
    found: Found
    written: tuple[str, ...]


class Helper(Protocol):
    """Who talks to the person."""

    def ask_for(self, wish: Wish) -> None:
        """Ask that only this servo be plugged in."""
        ...

    def see(self, found: Sequence[Found]) -> None:
        """Say who answers; called each time that changes."""
        ...

    def search(self, baud_rate: int) -> None:
        """Say at which rate a servo is looked for; called before each is tried."""
        ...

    def may_write(self, wish: Wish, found: Found) -> bool:
        """Return whether this servo may be written."""
        ...

    def settle(self, settled: Settled, *, last: bool) -> None:
        """Say that a servo is done; unless it is the last, that it be pulled out."""
        ...


def wishes(model: Model) -> list[Wish]:
    """Return what each servo of an arm shall be, in the arm file's order."""
    return [
        Wish(ServoSpec(servo.id, table_for(servo.model), joint.name), model.baud_rate, servo.eeprom)
        for joint in model.joints
        for servo in (joint.servo, *joint.shadows)
    ]


def commission(
    model: Model, port: str | None, helper: Helper, *, start: str | None, wait_s: float
) -> list[Settled]:
    """Give each servo of an arm its id, baud rate and settings.

    Args:
        model: The arm.
        port: See ``choose_port``.
        helper: Who talks to the person.
        start: The joint to begin with; the first if None.
        wait_s: How long to wait for each servo to be plugged in or out.

    Raises:
        UnknownNameError: The arm has no joint ``start``.
        PortError: No port, or it is lost.
        ServoSilentError: No servo came, or several stayed plugged in.
        CalibrationError: A servo is of another model.
        BusError: A servo did not keep what was written.
    """
    todo = _from(wishes(model), start)
    done: list[Settled] = []
    with open_port(chosen_port(model, port), model.baud_rate) as line:
        for wish in todo:
            settled = _settle(line, wish, helper, wait_s)
            last = wish is todo[-1]
            done.append(settled)
            helper.settle(settled, last=last)
            if not last:
                await_none(line, _place(wish, settled.found), wait_s)
    return done


def _settle(line: Port, wish: Wish, helper: Helper, wait_s: float) -> Settled:
    helper.ask_for(wish)
    found = await_one(line, wish.servo.table, wish.baud_rate, wait_s, helper.see, helper.search)
    check_model(found, wish)
    if not helper.may_write(wish, found):
        raise IkservoError("Cancelled; this servo was not changed.")
    return Settled(wish.servo, found, provision(line, found, wish))


def _from(todo: Sequence[Wish], start: str | None) -> Sequence[Wish]:
    names = [wish.servo.name for wish in todo]
    if start is None:
        return todo
    if start not in names:
        raise UnknownNameError("joint", start, names)
    return todo[names.index(start) :]


def _place(wish: Wish, found: Found) -> Found:
    return Found(wish.servo.id, wish.baud_rate, found.protocol, found.table)
