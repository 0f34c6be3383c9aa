"""One servo at a time: ping, read, write, lay ready, restart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, overload

from ikservo.clock import Clock
from ikservo.errors import BadValueError, RegisterAccessError
from ikservo.hardware.line.port import Port
from ikservo.hardware.packets.notation import Wanted, own_register, to_bytes
from ikservo.hardware.packets.replies import Reply, Status
from ikservo.hardware.questions import Questions
from ikservo.hardware.servo import Identity, ServoSpec
from ikservo.hardware.statistics import ServoStatistics
from ikservo.registers import Alarm, Area, Register, Role

__all__ = ["Conversation"]


class Conversation:
    """Reads and writes registers of single servos; ``ServoBus`` adds what concerns many."""

    def __init__(
        self, port: Port, servos: Sequence[ServoSpec], *, retries: int = 2, fast: bool = True
    ) -> None:
        self.port = port
        self.servos: Mapping[int, ServoSpec] = {servo.id: servo for servo in servos}
        self._questions = Questions(port, servos, retries, fast=fast)
        self._torque_on: set[int] = set()

    @property
    def clock(self) -> Clock:
        """Return the clock of the line; virtual where the servos are simulated."""
        return self.port.clock

    @property
    def statistics(self) -> Mapping[int, ServoStatistics]:
        """Return how well each servo answers."""
        return self._questions.statistics

    @property
    def alarms(self) -> Mapping[int, frozenset[Alarm]]:
        """Return what each servo complained about in its latest answer, if it ever spoke."""
        return self._questions.alarms

    def ping(self, servo_id: int) -> Identity:
        """Return what the servo says it is.

        Raises:
            BusError: It is silent or unintelligible.
        """
        servo = self._servo(servo_id)
        driver = self._questions.driver(servo)
        data = self._questions.one(servo, "identify itself", lambda: driver.ping(servo_id))
        if data:
            return Identity(servo_id, int.from_bytes(data[:2], "little"), data[2])
        return Identity(servo_id, self.read(servo_id, Role.MODEL_NUMBER, raw=True))

    @overload
    def read(self, servo_id: int, wanted: Wanted, *, raw: Literal[True]) -> int: ...
    @overload
    def read(self, servo_id: int, wanted: Wanted, *, raw: bool = False) -> float: ...
    def read(self, servo_id: int, wanted: Wanted, *, raw: bool = False) -> float:
        """Return a register of one servo.

        Raises:
            BusError: No usable answer, after repeats.
        """
        servo = self._servo(servo_id)
        register, driver = own_register(servo, wanted), self._questions.driver(servo)

        def question() -> Reply:
            return driver.read(servo_id, register.address, register.size)

        def holds(answer: Status) -> bool:
            again = question()
            return isinstance(again, Status) and again.data == answer.data

        confirm = holds if register.steady else None
        data = self._questions.one(servo, f"read {register}", question, confirm=confirm)
        number = register.decode(data)
        self._note(servo, register, number)
        return number if raw else register.to_value(number)

    def write(self, servo_id: int, wanted: Wanted, value: float, *, raw: bool = False) -> None:
        """Write a register of one servo and hear that it was taken.

        Raises:
            RegisterAccessError: The register forbids it; nothing was sent.
            BusError: The servo refused, or gave no usable answer after repeats.
        """
        servo = self._servo(servo_id)
        register, driver = own_register(servo, wanted), self._questions.driver(servo)
        data = self._permitted(servo, register, value, raw=raw)
        number = register.decode(data)

        def took(_: Status) -> bool:
            now = driver.read(servo_id, register.address, register.size)
            return isinstance(now, Status) and now.data == data

        elsewhere = register in (servo.table.id, servo.table.baud_rate)
        self._questions.one(
            servo,
            f"write {register} = {number}",
            lambda: driver.write(servo_id, register.address, data),
            repeat=not elsewhere and (register.name, number) not in servo.table.once,
            confirm=None if elsewhere else took,
        )
        self._note(servo, register, number)

    def reg_write(self, servo_id: int, wanted: Wanted, value: float, *, raw: bool = False) -> None:
        """Lay a write ready that ``action`` sets off; never repeated after a lost answer.

        Raises:
            RegisterAccessError: The register forbids it; nothing was sent.
            BusError: The servo refused, or gave no usable answer.
        """
        servo = self._servo(servo_id)
        register, driver = own_register(servo, wanted), self._questions.driver(servo)
        data = self._permitted(servo, register, value, raw=raw)
        self._questions.one(
            servo,
            f"register a write of {register}",
            lambda: driver.reg_write(servo_id, register.address, data),
            repeat=False,
        )

    def action(self) -> None:
        """Set off what was laid ready, on all servos at the same moment."""
        for driver in self._questions.drivers.values():
            driver.action()

    def reboot(self, servo_id: int) -> None:
        """Restart a servo; its torque is lost.

        Raises:
            BusError: It refused or its family knows no reboot.
        """
        servo = self._servo(servo_id)
        driver = self._questions.driver(servo)
        self._questions.one(servo, "reboot", lambda: driver.reboot(servo_id), repeat=False)
        self._torque_on.discard(servo_id)

    def read_alarms(self, servo_id: int) -> frozenset[Alarm]:
        """Return what the servo complains about: its own register, or beside its answers.

        Raises:
            BusError: No usable answer, after repeats.
        """
        if Role.ALARMS in self._servo(servo_id).table.lacks:
            self.ping(servo_id)
        else:
            self.read(servo_id, Role.ALARMS)
        return self.alarms[servo_id]

    def _servo(self, servo_id: int) -> ServoSpec:
        if servo_id not in self.servos:
            known = ", ".join(str(servo) for servo in self.servos.values())
            raise BadValueError("The servo id", servo_id, f"one of {known}")
        return self.servos[servo_id]

    def _permitted(self, servo: ServoSpec, register: Register, value: float, *, raw: bool) -> bytes:
        if register.area is Area.EEPROM and servo.id in self._torque_on:
            raise RegisterAccessError(
                str(servo), register.name, "it is in EEPROM and torque is on", "Switch torque off."
            )
        return to_bytes(servo, register, value, raw=raw)

    def _note(self, servo: ServoSpec, register: Register, number: int) -> None:
        """Remember what a register tells about torque and alarms."""
        if register is servo.table.torque_enable:
            (self._torque_on.add if number == 1 else self._torque_on.discard)(servo.id)
        elif Role.ALARMS not in servo.table.lacks and register is servo.table.alarms:
            self._questions.alarms[servo.id] = servo.table.decode_alarms(number)
