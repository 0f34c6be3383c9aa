"""The servos on one line, spoken to in registers and joints instead of addresses and bytes."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Hashable, Iterable, Mapping, Sequence
from types import TracebackType
from typing import Any, Literal, Self, TypeVar, overload

from ikservo.errors import BusError
from ikservo.hardware.conversation import Conversation
from ikservo.hardware.finding.chain_order import silence_hint
from ikservo.hardware.finding.roll_call import RollCall
from ikservo.hardware.gathering import scatter
from ikservo.hardware.line.port import Port
from ikservo.hardware.line.replug import reopen
from ikservo.hardware.packets.block import rounds, written
from ikservo.hardware.packets.layout import Layout
from ikservo.hardware.packets.notation import Wanted, own_register
from ikservo.hardware.plan import Cell, Plan, plan_reading, plan_writing
from ikservo.hardware.readings import Readings
from ikservo.hardware.servo import ServoSpec
from ikservo.registers import Family, Register, Role

__all__ = ["ServoBus"]

_MOST_PLANS = 64  # more than a program repeats; a program that never repeats must not fill memory

_Key = TypeVar("_Key", bound=Wanted)


class ServoBus(Conversation):
    """Reads and writes registers of the servos on one port.

    Registers may come from any table, or be a ``Role``: each servo's own register of that name
    is used, so that one call serves a line with several models. Values are in the register's
    unit; ``raw=True`` gives and takes its integer, for positions the tick.

    Programs may use it without an arm; ``bulk_write``, ``roll_call``, ``reg_write`` and
    ``action`` are there for them, nothing in ikservo calls these.

    Args:
        port: The line.
        servos: Who should be on it, in the order of the cable.
        retries: How often a question is put again whose answer is lost.
        fast: Whether fast sync read is tried where the family has it.

    Attributes:
        port: The line.
        servos: By id.
    """

    def __init__(
        self, port: Port, servos: Sequence[ServoSpec], *, retries: int = 2, fast: bool = True
    ) -> None:
        super().__init__(port, servos, retries=retries, fast=fast)
        self._plans: dict[Hashable, Plan] = {}
        self._writings: dict[Hashable, Sequence[Cell]] = {}

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
        """Return a register of many servos; see ``bulk_read``."""
        readings = self.sync_read_many(servo_ids, (wanted,), raw=raw)
        values = {servo_id: next(iter(row.values())) for servo_id, row in readings.values.items()}
        return Readings(values, readings.errors, readings.alarms, readings.hint)

    @overload
    def sync_read_many(
        self, servo_ids: Iterable[int], wanted: Sequence[_Key], *, raw: Literal[True]
    ) -> Readings[Mapping[_Key, int]]: ...
    @overload
    def sync_read_many(
        self, servo_ids: Iterable[int], wanted: Sequence[_Key], *, raw: bool = False
    ) -> Readings[Mapping[_Key, float]]: ...
    def sync_read_many(
        self, servo_ids: Iterable[int], wanted: Sequence[_Key], *, raw: bool = False
    ) -> Readings[Mapping[_Key, int]] | Readings[Mapping[_Key, float]]:
        """Return the same registers of many servos; see ``bulk_read``."""
        ids, keys = tuple(servo_ids), tuple(wanted)
        plan = self._plans.get((ids, keys))
        if plan is None:
            plan = self._planned((ids, keys), dict.fromkeys(ids, keys))
        return self._carried_out(plan, raw=raw)

    @overload
    def bulk_read(
        self, wanted: Mapping[int, Sequence[_Key]], *, raw: Literal[True]
    ) -> Readings[Mapping[_Key, int]]: ...
    @overload
    def bulk_read(
        self, wanted: Mapping[int, Sequence[_Key]], *, raw: bool = False
    ) -> Readings[Mapping[_Key, float]]: ...
    def bulk_read(
        self, wanted: Mapping[int, Sequence[_Key]], *, raw: bool = False
    ) -> Readings[Mapping[_Key, int]] | Readings[Mapping[_Key, float]]:
        """Return of each servo its own registers, with as few questions as the family allows.

        Neighbouring registers share one question. Raises only where the port is lost. A servo
        that does not answer stands among ``errors``, after one repeat for all such together; one
        that has been deaf for long is asked only every so often.
        """
        key = tuple((servo_id, tuple(keys)) for servo_id, keys in wanted.items())
        return self._carried_out(self._plans.get(key) or self._planned(key, wanted), raw=raw)

    def _planned(self, key: Hashable, wanted: Mapping[int, Sequence[Wanted]]) -> Plan:
        plan = plan_reading({self._servo(i): keys for i, keys in wanted.items()})
        if len(self._plans) >= _MOST_PLANS:
            self._plans.clear()
        self._plans[key] = plan
        return plan

    def _carried_out(self, plan: Plan, *, raw: bool) -> Readings[Mapping[Any, Any]]:
        values: dict[int, dict[Wanted, float]] = {servo_id: {} for servo_id in plan.servo_ids}
        errors: dict[int, BusError] = {}
        for step in plan.rounds:
            data, missing = self._questions.many(step)
            errors |= missing
            for servo_id, block in data.items():
                values[servo_id] |= self._told(servo_id, block, step.layouts[servo_id], raw=raw)
        for servo_id in errors:
            del values[servo_id]
        hint = silence_hint(self.servos.values(), values, errors) if errors else ""
        alarms = {i: found for i in values if (found := self.alarms.get(i))}
        return Readings(values, errors, alarms, hint)

    def _told(
        self, servo_id: int, block: bytes, layout: Layout, *, raw: bool
    ) -> Mapping[Wanted, float]:
        """Return what an answer says, and remember what of it is about torque or alarms."""
        numbers = layout.numbers(block)
        for key, register in layout.telling.items():
            self._note(self.servos[servo_id], register, numbers[key])
        if raw:
            return numbers
        return {key: r.to_value(numbers[key]) for key, r in layout.registers.items()}

    def sync_write(self, wanted: Wanted, values: Mapping[int, float], *, raw: bool = False) -> None:
        """Write a register of many servos at once; the protocols give no answer to this.

        Raises:
            RegisterAccessError: A register forbids its value; nothing was sent to any servo.
        """
        cells = self._cells(tuple(values), wanted)
        rows = {
            cell.servo.id: self._written(cell, value, raw=raw)
            for cell, value in zip(cells, values.values(), strict=True)
        }
        packets: dict[Family, dict[int, tuple[int, bytes]]] = defaultdict(dict)
        for cell in cells:
            own = packets[cell.servo.table.family]
            own[cell.servo.id] = (cell.register.address, rows[cell.servo.id])
        for family, packet in packets.items():
            scatter(self._questions.drivers[family], packet)
        for cell in cells:
            if cell.telling:
                self._note(cell.servo, cell.register, cell.register.decode(rows[cell.servo.id]))

    def _written(self, cell: Cell, value: float, *, raw: bool) -> bytes:
        """Return the bytes of a value; the quick way is that of goals, cycle after cycle."""
        register = cell.register
        if raw and cell.plain and type(value) is int:
            lower, upper = register.range
            if lower <= value <= upper:
                return register.encode(value)
        return self._permitted(cell.servo, register, value, raw=raw)

    def _cells(self, ids: tuple[int, ...], wanted: Wanted) -> Sequence[Cell]:
        key = (ids, wanted)
        if key not in self._writings:
            if len(self._writings) >= _MOST_PLANS:
                self._writings.clear()
            self._writings[key] = plan_writing(map(self._servo, ids), wanted)
        return self._writings[key]

    def bulk_write(self, values: Mapping[int, Mapping[_Key, float]], *, raw: bool = False) -> None:
        """Write of each servo its own registers; the protocols give no answer to this.

        Neighbouring registers share a packet, and so do servos as far as the family allows.

        Raises:
            RegisterAccessError: A register forbids its value; nothing was sent to any servo.
        """
        own: dict[int, dict[Register, bytes]] = {}
        for servo_id, row in values.items():
            servo = self._servo(servo_id)
            pairs = [(own_register(servo, key), value) for key, value in row.items()]
            own[servo_id] = {r: self._permitted(servo, r, value, raw=raw) for r, value in pairs}
        for runs in rounds(own):
            packets: dict[Family, dict[int, tuple[int, bytes]]] = defaultdict(dict)
            for servo_id, run in runs.items():
                family = self.servos[servo_id].table.family
                packets[family][servo_id] = (run[0].address, written(own[servo_id], run))
            for family, rows in packets.items():
                scatter(self._questions.drivers[family], rows)
        for servo_id, row in own.items():
            for register, data in row.items():
                self._note(self.servos[servo_id], register, register.decode(data))

    def roll_call(self, family: Family, highest_id: int | None = None) -> RollCall:
        """Ask everybody of a family on the line, known or not, whether they are there.

        Args:
            family: The dialect to ask in.
            highest_id: Up to which id to wait for; the highest known one if not given.

        Raises:
            PortLostError: The line is gone.
        """
        last = max(self.servos) if highest_id is None else highest_id
        return self._questions.drivers[family].roll_call(last)

    def learn_return_delays(self) -> None:
        """Wait no longer for answers than these servos' own return delay registers demand.

        Until then the longest delay that the registers can hold is assumed of each servo. Where
        one does not tell, that stays so.
        """
        readings = self.sync_read(self.servos, Role.RETURN_DELAY)
        for family, driver in self._questions.drivers.items():
            ids = [i for i, servo in self.servos.items() if servo.table.family is family]
            if readings.errors.keys().isdisjoint(ids):
                driver.set_return_delay(max(readings.values[i] for i in ids))

    def reopen(self, serial_number: str, within_s: float) -> None:
        """Go on after the adapter was pulled and plugged in again; nothing moves.

        Args:
            serial_number: Of the adapter, from ``serial_number_of`` before the loss.
            within_s: How long to wait for it.

        Raises:
            PortLostError: It did not come back in time.
        """
        reopen(self.port, serial_number, within_s)
        self._torque_on.clear()
        self.sync_read(self.servos, Role.TORQUE_ENABLE)  # the servos may have been without power

    def close(self) -> None:
        """Give the port back."""
        self.port.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self.close()
