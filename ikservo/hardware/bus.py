"""``ServoBus``: read and write registers of all servos on one port, many at once."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Hashable, Iterable, Mapping, Sequence
from typing import Any, Literal, Self, TypeVar, overload

from ikservo.errors import BusError
from ikservo.hardware.port import Port
from ikservo.hardware.port_names import reconnect
from ikservo.hardware.protocols.driver import BroadcastPingResult
from ikservo.hardware.register_access import RegisterAccess
from ikservo.hardware.register_batches import (
    ReadPlan,
    RegisterRef,
    WriteTarget,
    batch_write,
    batches,
    plan_reads,
    plan_writes,
    resolve_register,
)
from ikservo.hardware.requester import silence_hint
from ikservo.hardware.serial_ports import line_hint
from ikservo.hardware.servo import Readings, ServoSpec
from ikservo.registers import Family, Register, RegisterName

_MAX_CACHED_PLANS = 64  # more requests than a program repeats; limits the memory

_Key = TypeVar("_Key", bound=RegisterRef)


class ServoBus(RegisterAccess):
    """Read and write registers of the servos on one port.

    A register may come from any table, or be a ``RegisterName``, which means the register of that
    name in each servo's table, so that one call works for servos of several models. Values are in
    the register's unit; ``raw=True`` uses the raw integer (ticks for positions).

    Programs may use a bus without an arm; ``bulk_write``, ``broadcast_ping``, ``reg_write`` and
    ``action`` are part of this interface, although ikservo does not call them.

    Args:
        port: The port.
        servos: The expected servos, in their order along the cable.
        retries: The number of repetitions of a request after a lost reply.
        fast: Whether fast sync read is tried if the family supports it.

    Attributes:
        servos: The servos by id.
    """

    def __init__(
        self, port: Port, servos: Sequence[ServoSpec], *, retries: int = 2, fast: bool = True
    ) -> None:
        super().__init__(port, servos, retries=retries, fast=fast)
        self._plans: dict[Hashable, ReadPlan] = {}
        self._writings: dict[Hashable, Sequence[WriteTarget]] = {}

    @overload
    def sync_read(
        self, servo_ids: Iterable[int], ref: RegisterRef, *, raw: Literal[True]
    ) -> Readings[int]: ...
    @overload
    def sync_read(
        self, servo_ids: Iterable[int], ref: RegisterRef, *, raw: bool = False
    ) -> Readings[float]: ...
    def sync_read(
        self, servo_ids: Iterable[int], ref: RegisterRef, *, raw: bool = False
    ) -> Readings[int] | Readings[float]:
        """Read one register of many servos; see ``bulk_read``."""
        readings = self.sync_read_many(servo_ids, (ref,), raw=raw)
        values = {servo_id: next(iter(row.values())) for servo_id, row in readings.values.items()}
        return Readings(values, readings.errors, readings.alarms, readings.hint)

    @overload
    def sync_read_many(
        self, servo_ids: Iterable[int], refs: Sequence[_Key], *, raw: Literal[True]
    ) -> Readings[Mapping[_Key, int]]: ...
    @overload
    def sync_read_many(
        self, servo_ids: Iterable[int], refs: Sequence[_Key], *, raw: bool = False
    ) -> Readings[Mapping[_Key, float]]: ...
    def sync_read_many(
        self, servo_ids: Iterable[int], refs: Sequence[_Key], *, raw: bool = False
    ) -> Readings[Mapping[_Key, int]] | Readings[Mapping[_Key, float]]:
        """Read the same registers of many servos; see ``bulk_read``."""
        ids, keys = tuple(servo_ids), tuple(refs)
        plan = self._plans.get((ids, keys))
        if plan is None:
            plan = self._read_plan((ids, keys), dict.fromkeys(ids, keys))
        return self._execute_plan(plan, raw=raw)

    @overload
    def bulk_read(
        self, refs: Mapping[int, Sequence[_Key]], *, raw: Literal[True]
    ) -> Readings[Mapping[_Key, int]]: ...
    @overload
    def bulk_read(
        self, refs: Mapping[int, Sequence[_Key]], *, raw: bool = False
    ) -> Readings[Mapping[_Key, float]]: ...
    def bulk_read(
        self, refs: Mapping[int, Sequence[_Key]], *, raw: bool = False
    ) -> Readings[Mapping[_Key, int]] | Readings[Mapping[_Key, float]]:
        """Read registers that may differ between servos, with as few requests as the family allows.

        Neighbouring registers are read together. An error is raised only if the port is lost. A
        servo that does not reply is in ``errors``, after one common retry of all silent servos; a
        servo that has been silent for long is polled at a reduced rate.
        """
        key = tuple((servo_id, tuple(keys)) for servo_id, keys in refs.items())
        return self._execute_plan(self._plans.get(key) or self._read_plan(key, refs), raw=raw)

    def _read_plan(self, key: Hashable, refs: Mapping[int, Sequence[RegisterRef]]) -> ReadPlan:
        plan = plan_reads({self._require_servo(i): keys for i, keys in refs.items()})
        if len(self._plans) >= _MAX_CACHED_PLANS:
            self._plans.clear()
        self._plans[key] = plan
        return plan

    def _execute_plan(self, plan: ReadPlan, *, raw: bool) -> Readings[Mapping[Any, Any]]:
        values: dict[int, dict[RegisterRef, float]] = {servo_id: {} for servo_id in plan.servo_ids}
        errors: dict[int, BusError] = {}
        for step in plan.batches:
            data, missing = self._requester.request_many(step)
            errors |= missing
            for servo_id, block in data.items():
                layout = step.layouts[servo_id]
                numbers = layout.decode_raw(block)
                for key, register in layout.state_registers.items():
                    self._track_state(self.servos[servo_id], register, numbers[key])
                values[servo_id] |= (
                    numbers
                    if raw
                    else {key: r.to_value(numbers[key]) for key, r in layout.registers.items()}
                )
        for servo_id in errors:
            del values[servo_id]
        hint = silence_hint(self.servos.values(), values, errors) if errors else ""
        hint = line_hint(self.port.name, hint) if hint else ""
        alarms = {i: found for i in values if (found := self._requester.alarms.get(i))}
        return Readings(values, errors, alarms, hint)

    def sync_write(
        self, ref: RegisterRef, values: Mapping[int, float], *, raw: bool = False
    ) -> None:
        """Write a register of many servos with one packet, to which servos do not reply.

        Raises:
            RegisterAccessError: A register does not allow the given value; nothing was sent to any
                servo.
        """
        key = (tuple(values), ref)
        if key not in self._writings:
            if len(self._writings) >= _MAX_CACHED_PLANS:
                self._writings.clear()
            self._writings[key] = plan_writes(map(self._require_servo, values), ref)
        cells = self._writings[key]
        batch: dict[tuple[Family, int, int], dict[int, bytes]] = defaultdict(dict)
        for cell, value in zip(cells, values.values(), strict=True):
            lower, upper = cell.register.range
            # This fast path serves the goals, which are sent in every cycle.
            if raw and cell.plain and type(value) is int and lower <= value <= upper:
                data = cell.register.encode(value)
            else:
                data = self._check_write(cell.servo, cell.register, value, raw=raw)
            batch[cell.place][cell.servo.id] = data
        for cell in cells:
            self._check_goal(cell.servo, cell.register, batch[cell.place][cell.servo.id])
        batch_write(self._requester.drivers, batch)
        for cell in cells:
            if cell.tracks_state:
                data = batch[cell.place][cell.servo.id]
                self._track_state(cell.servo, cell.register, cell.register.decode(data))

    def bulk_write(self, values: Mapping[int, Mapping[_Key, float]], *, raw: bool = False) -> None:
        """Write registers that may differ between servos, without replies from the servos.

        Neighbouring registers share a packet, and so do several servos if the family allows it.

        Raises:
            RegisterAccessError: A register does not allow the given value; nothing was sent to any
                servo.
        """
        own: dict[int, dict[Register, bytes]] = {}
        for servo_id, row in values.items():
            servo = self._require_servo(servo_id)
            pairs = [(resolve_register(servo, key), value) for key, value in row.items()]
            own[servo_id] = {r: self._check_write(servo, r, value, raw=raw) for r, value in pairs}
        for servo_id, row in own.items():
            for register, data in row.items():
                self._check_goal(self.servos[servo_id], register, data)
        for runs in batches(own):
            batch: dict[tuple[Family, int, int], dict[int, bytes]] = defaultdict(dict)
            for servo_id, run in runs.items():
                data = b"".join(own[servo_id][register] for register in run)
                place = self.servos[servo_id].table.family, run[0].address, len(data)
                batch[place][servo_id] = data
            batch_write(self._requester.drivers, batch)
        for servo_id, row in own.items():
            for register, data in row.items():
                self._track_state(self.servos[servo_id], register, register.decode(data))

    def broadcast_ping(self, family: Family, highest_id: int | None = None) -> BroadcastPingResult:
        """Ping all servos of a family on the bus, including unknown servos.

        Args:
            family: The protocol family.
            highest_id: The last id to wait for; None uses the highest id of a known servo.

        Raises:
            PortLostError: The port is lost.
        """
        last = max(self.servos) if highest_id is None else highest_id
        return self._requester.drivers[family].broadcast_ping(last)

    def load_return_delays(self) -> None:
        """Shorten reply timeouts to the return delays that are set in these servos.

        Before this call, the longest delay that the register can hold is assumed for each servo. If
        a servo does not reply or has no such register, the assumption stays.
        """
        role = RegisterName.RETURN_DELAY
        settable = [i for i, servo in self.servos.items() if role not in servo.table.missing]
        readings = self.sync_read(settable, role)
        for family, driver in self._requester.drivers.items():
            ids = [i for i, servo in self.servos.items() if servo.table.family is family]
            if readings.values.keys() >= set(ids):
                driver.set_return_delay(max(readings.values[i] for i in ids))

    def reconnect(self, serial_number: str, within_s: float) -> None:
        """Reconnect to an adapter that was unplugged, by its serial number; nothing moves.

        Raises:
            PortLostError: The adapter did not come back in time.
        """
        reconnect(self.port, serial_number, within_s)
        self._torque_on.clear()
        # The servos may have been without power, so that their torque is off now.
        self.sync_read(self.servos, RegisterName.TORQUE_ENABLE)

    def close(self) -> None:
        """Stop listening for stops from other programs, and close the port."""
        if self.stop_listener is not None:
            self.stop_listener.close()
        self.port.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
