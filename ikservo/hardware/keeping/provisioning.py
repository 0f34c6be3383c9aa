"""One servo gets its id, its baud rate and no return delay, and is asked whether it kept them."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass

from ikservo.errors import BadValueError, BusError, CalibrationError, ServoRefusedError
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.finding.identify import Found
from ikservo.hardware.keeping.eeprom import update_eeprom
from ikservo.hardware.line.port import Port
from ikservo.hardware.packets.notation import Wanted
from ikservo.hardware.servo import ServoSpec
from ikservo.registers import Register, Role, ServoTable

__all__ = ["Wish", "check_model", "provision"]


@dataclass(frozen=True, slots=True)
class Wish:
    """What a servo shall be.

    Attributes:
        servo: Its id, table and joint.
        baud_rate: At which it shall answer.
        eeprom: Raw numbers that it must hold besides, by register name.
    """

    servo: ServoSpec
    baud_rate: int
    eeprom: Mapping[str, int]

    @property
    def baud_code(self) -> int:
        """Return what stands in the baud rate register for this rate.

        Raises:
            BadValueError: The model cannot talk at this rate.
        """
        rates = self.servo.table.baud_rates
        codes = {rate: code for code, rate in rates.items()}
        if self.baud_rate not in codes:
            known = ", ".join(map(str, sorted(codes)))
            raise BadValueError(f"The baud rate of {self.servo}", self.baud_rate, f"one of {known}")
        return codes[self.baud_rate]


def provision(port: Port, found: Found, wish: Wish) -> tuple[str, ...]:
    """Make the only servo on a line what it shall be; return what was written, in words.

    Nothing is written that holds already. Its EEPROM is locked again, also after a failure.

    Args:
        port: The line; afterwards at the servo's new rate.
        found: Who answers, and where.
        wish: What it shall be.

    Raises:
        CalibrationError: It is of another model; nothing was written.
        BadValueError: It cannot talk at the wanted rate, or lacks a register; nothing was written.
        ServoRefusedError: It did not keep a number.
        BusError: It does not answer.
    """
    check_model(found, wish)
    wanted = _wanted(wish)
    code = wish.baud_code
    with _Patient(port, found, wish) as servo:
        servo.become(wish.servo.id, code)
        servo.keep(wanted)
    return tuple(servo.written)


def check_model(found: Found, wish: Wish) -> None:
    """Compare the servo on the line with the model that the arm file names.

    Raises:
        CalibrationError: It is of another model, perhaps of another family.
    """
    if found.table is not wish.servo.table:
        raise CalibrationError(
            f"{wish.servo} must be a {wish.servo.table.model_name}, but a {found} is connected.",
            "Connect the right servo, or choose another arm. Nothing was written.",
        )


def _wanted(wish: Wish) -> dict[Wanted, int]:
    """Return the registers that are not id and baud rate, and what must stand in them.

    Raises:
        BadValueError: The model has no register of some name.
    """
    table = wish.servo.table
    missing = [name for name in wish.eeprom if name not in table.registers]
    if missing:
        known = ", ".join(table.registers)
        raise BadValueError(f"A register of {wish.servo}", repr(missing[0]), f"one of {known}")
    delay: dict[Wanted, int] = {} if Role.RETURN_DELAY in table.lacks else {table.return_delay: 0}
    return delay | {table.registers[name]: number for name, number in wish.eeprom.items()}


class _Patient:
    """The servo under treatment: wherever it answers, it is spoken to there."""

    def __init__(self, port: Port, found: Found, wish: Wish) -> None:
        self._port, self._wish = port, wish
        self._table: type[ServoTable] = wish.servo.table
        self._id, self._rate = found.id, found.baud_rate
        self.written: list[str] = []

    def __enter__(self) -> _Patient:
        self._port.setBaudRate(self._rate)
        self._bus.write(self._id, Role.TORQUE_ENABLE, 0, raw=True)
        return self

    def __exit__(self, kind: object, error: object, at: object) -> None:
        """Lock the memory, whatever happened; a failure on the way is the one to tell."""
        lock = self._table.eeprom_lock
        if lock is None:
            return
        with contextlib.suppress(BusError) if error else contextlib.nullcontext():
            self._bus.write(self._id, lock, 1, raw=True)
            self._verify(lock, 1)

    @property
    def _bus(self) -> ServoBus:
        return ServoBus(self._port, [ServoSpec(self._id, self._table, self._wish.servo.name)])

    def become(self, servo_id: int, baud_code: int) -> None:
        """Give it its id, then its rate; it answers with the one or the other, old or new."""
        if self._id != servo_id:
            self._unlock()
            self._change(self._table.id, servo_id)
            self._id = servo_id
            self._verify(self._table.id, servo_id)
        if self._rate != self._wish.baud_rate:
            self._unlock()
            self._change(self._table.baud_rate, baud_code)
            self._rate = self._wish.baud_rate
            self._port.setBaudRate(self._rate)
        self._verify(self._table.baud_rate, baud_code)

    def keep(self, wanted: Mapping[Wanted, int]) -> None:
        """Write what differs of everything else, and verify it."""
        for change in update_eeprom(self._bus, self._id, wanted):
            self.written.append(f"{change.register} {change.found} → {change.wanted}")

    def _unlock(self) -> None:
        lock = self._table.eeprom_lock
        if lock is not None:
            self._bus.write(self._id, lock, 0, raw=True)

    def _change(self, register: Register, number: int) -> None:
        """Write once, without minding the answer: whether it was taken is asked afterwards."""
        spec = ServoSpec(self._id, self._table, self._wish.servo.name)
        before = self._bus.read(self._id, register, raw=True)
        with contextlib.suppress(BusError):
            ServoBus(self._port, [spec], retries=0).write(self._id, register, number, raw=True)
        self.written.append(f"{register} {before} → {number}")

    def _verify(self, register: Register, number: int) -> None:
        found = self._bus.read(self._id, register, raw=True)
        if found != number:
            raise ServoRefusedError(
                f"holds {register} = {found} after {number} was written",
                "Its EEPROM may be worn out or locked.",
                servo=str(self._wish.servo),
                servo_id=self._id,
                port=self._port.name,
            )
