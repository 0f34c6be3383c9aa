"""The servos on one line, spoken to in registers and joints instead of addresses and bytes."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from types import TracebackType
from typing import Literal, overload

from ikservo.clock import Clock
from ikservo.errors import BadValueError, BusError, RegisterAccessError
from ikservo.hardware.block import decoded, rounds
from ikservo.hardware.notation import Wanted, own_register, to_bytes
from ikservo.hardware.port import Port
from ikservo.hardware.questions import Questions, Span
from ikservo.hardware.readings import Readings
from ikservo.hardware.servo import Identity, ServoSpec
from ikservo.hardware.statistics import ServoStatistics
from ikservo.registers import Alarm, Area, Family, Register, Role

__all__ = ["ServoBus"]


class ServoBus:
    """Reads and writes registers of the servos on one port.

    Registers may come from any table, or be a ``Role``: each servo's own register of that name
    is used, so that one call serves a line with several models. Values are in the register's
    unit; ``raw=True`` gives and takes its integer, for positions the tick.

    Args:
        port: The line.
        servos: Who should be on it.
        retries: How often a question is put again whose answer is lost.
        fast: Whether fast sync read is tried where the family has it.

    Attributes:
        port: The line.
        servos: By id.
    """

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

    # --- one servo ---

    def ping(self, servo_id: int) -> Identity:
        """Return what the servo says it is.

        Raises:
            BusError: It is silent or unintelligible.
        """
        servo = self._servo(servo_id)
        driver = self._questions.driver(servo)
        data = self._questions.one(servo, "say who it is", lambda: driver.ping(servo_id))
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
        data = self._questions.one(
            servo,
            f"read {register}",
            lambda: driver.read(servo_id, register.address, register.size),
        )
        number = register.decode(data)
        self._note(servo, register, number)
        return _shown(register, number, raw=raw)

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
        self._questions.one(
            servo,
            f"write {register} = {number}",
            lambda: driver.write(servo_id, register.address, data),
            repeat=(register.name, number) not in servo.table.once,
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
            f"hold {register} ready",
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
        """Return what the servo complains about, from its own register.

        Raises:
            BusError: No usable answer, after repeats.
        """
        self.read(servo_id, Role.ALARMS)
        return self.alarms[servo_id]

    # --- many servos ---

    @overload
    def sync_read(
        self, servo_ids: Iterable[int], wanted: Wanted, *, raw: Literal[True]
    ) -> Readings[int]: ...
    @overload
    def sync_read(
        self, servo_ids: Iterable[int], wanted: Wanted, *, raw: bool = False
    ) -> Readings[float]: ...
    def sync_read(
        self, servo_ids: Iterable[int], wanted: Wanted, *, raw: bool = False
    ) -> Readings[int] | Readings[float]:
        """Return a register of many servos; see ``sync_read_many``."""
        readings = self.sync_read_many(servo_ids, (wanted,), raw=raw)
        values = {servo_id: row[wanted] for servo_id, row in readings.values.items()}
        return Readings(values, readings.errors, readings.alarms)

    @overload
    def sync_read_many(
        self, servo_ids: Iterable[int], wanted: Sequence[Wanted], *, raw: Literal[True]
    ) -> Readings[Mapping[Wanted, int]]: ...
    @overload
    def sync_read_many(
        self, servo_ids: Iterable[int], wanted: Sequence[Wanted], *, raw: bool = False
    ) -> Readings[Mapping[Wanted, float]]: ...
    def sync_read_many(
        self, servo_ids: Iterable[int], wanted: Sequence[Wanted], *, raw: bool = False
    ) -> Readings[Mapping[Wanted, int]] | Readings[Mapping[Wanted, float]]:
        """Return registers of many servos; neighbouring registers share one question.

        Raises only where the port is lost. A servo that does not answer stands among ``errors``,
        after one repeat for all such together; one that has been deaf for long is not repeated.
        """
        own = {i: [own_register(self._servo(i), key) for key in wanted] for i in servo_ids}
        numbers: dict[int, dict[Register, int]] = {servo_id: {} for servo_id in own}
        errors: dict[int, BusError] = {}
        for runs in rounds(own):
            data, missing = self._read_runs(runs)
            errors |= missing
            for servo_id, block in data.items():
                numbers[servo_id] |= decoded(block, runs[servo_id])
                for register in runs[servo_id]:
                    self._note(self.servos[servo_id], register, numbers[servo_id][register])
        values = {
            servo_id: {
                key: _shown(register, numbers[servo_id][register], raw=raw)
                for key, register in zip(wanted, registers, strict=True)
            }
            for servo_id, registers in own.items()
            if servo_id not in errors
        }
        return Readings(values, errors, {i: self.alarms[i] for i in values if self.alarms[i]})

    def _read_runs(
        self, runs: Mapping[int, Sequence[Register]]
    ) -> tuple[dict[int, bytes], dict[int, BusError]]:
        asked = f"read {', '.join(register.name for register in next(iter(runs.values())))}"
        spans = {
            servo_id: Span(run[0].address, run[-1].end - run[0].address)
            for servo_id, run in runs.items()
        }
        return self._questions.many([self.servos[i] for i in runs], spans, asked)

    def sync_write(self, wanted: Wanted, values: Mapping[int, float], *, raw: bool = False) -> None:
        """Write a register of many servos at once; the protocols give no answer to this.

        Raises:
            RegisterAccessError: A register forbids its value; nothing was sent to any servo.
        """
        rows: dict[tuple[Family, int], dict[int, bytes]] = defaultdict(dict)
        for servo_id, value in values.items():
            servo = self._servo(servo_id)
            register = own_register(servo, wanted)
            data = self._permitted(servo, register, value, raw=raw)
            rows[servo.table.family, register.address][servo_id] = data
        for (family, address), data_by_id in rows.items():
            self._questions.drivers[family].sync_write(address, data_by_id)
            for servo_id, data in data_by_id.items():
                servo = self.servos[servo_id]
                register = own_register(servo, wanted)
                self._note(servo, register, register.decode(data))

    # --- the line ---

    def learn_return_delays(self) -> None:
        """Wait no longer for answers than these servos' own return delay registers demand.

        Until then the longest delay that the registers can hold is assumed of each servo. Where
        one does not tell, that stays so.
        """
        readings = self.sync_read(self.servos, Role.RETURN_DELAY)
        for family, driver in self._questions.drivers.items():
            ids = [i for i, servo in self.servos.items() if servo.table.family is family]
            if readings.errors.keys().isdisjoint(ids):
                driver.exchange.return_delay_s = max(readings.values[i] for i in ids)

    def close(self) -> None:
        """Give the port back."""
        self.port.close()

    def __enter__(self) -> ServoBus:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self.close()

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
        if register is servo.table.alarms:
            self._questions.alarms[servo.id] = servo.table.decode_alarms(number)


def _shown(register: Register, number: int, *, raw: bool) -> float:
    return number if raw else register.to_value(number)
