"""``ServoBus``: ping, read, write, sync and bulk access, reboot, for servos of all families."""

from __future__ import annotations

import contextlib
from collections import defaultdict
from collections.abc import Generator, Hashable, Iterable, Mapping, Sequence
from types import TracebackType
from typing import Any, Literal, NoReturn, Self, TypeVar, overload

from ikservo.clock import Clock
from ikservo.errors import BadValueError, BusError, PortError, RegisterAccessError
from ikservo.hardware.driver import BroadcastPingResult
from ikservo.hardware.packets import Reply, Status
from ikservo.hardware.port import Port
from ikservo.hardware.read_plan import (
    ReadPlan,
    RegisterRef,
    ReplyLayout,
    WriteTarget,
    batch_write,
    batches,
    encode_value,
    is_goal,
    join_bytes,
    plan_reads,
    plan_writes,
    resolve_register,
)
from ikservo.hardware.remembered_port import reconnect
from ikservo.hardware.requester import Requester, silence_hint
from ikservo.hardware.servo import PingResult, Readings, ServoSpec, ServoStatistics
from ikservo.registers import Alarm, Area, Family, Register, RegisterName

__all__ = ["MAX_ENABLING_TICKS", "Conversation", "ServoBus"]


MAX_ENABLING_TICKS = 170
"""The furthest goal from a servo's position with which its torque is switched on.

A joint that is a little outside its servo's limits comes back to them; one that is further outside
is on another revolution and would turn all the way back.
"""


class Conversation:
    """Read and write registers of single servos; ``ServoBus`` adds group operations."""

    def __init__(
        self, port: Port, servos: Sequence[ServoSpec], *, retries: int = 2, fast: bool = True
    ) -> None:
        self.port = port
        self.servos: Mapping[int, ServoSpec] = {servo.id: servo for servo in servos}
        self._requester = Requester(port, servos, retries, fast=fast)
        self._torque_on: set[int] = set()
        self._enabling: Mapping[int, int] = {}
        self._prepared_goals = set[int]()

    @property
    def clock(self) -> Clock:
        """Return the clock of the line; virtual where the servos are simulated."""
        return self.port.clock

    @property
    def statistics(self) -> Mapping[int, ServoStatistics]:
        """Return the reply statistics of each servo."""
        return self._requester.statistics

    @property
    def alarms(self) -> Mapping[int, frozenset[Alarm]]:
        """Return the alarms in the latest reply of each servo that has replied."""
        return self._requester.alarms

    def ping(self, servo_id: int) -> PingResult:
        """Return the identity that a servo reports.

        Raises:
            BusError: It does not reply, or its reply is invalid.
        """
        servo = self._require_servo(servo_id)
        driver = self._requester.driver_of(servo)
        data = self._requester.request(servo, "identify itself", lambda: driver.ping(servo_id))
        if data:
            return PingResult(servo_id, int.from_bytes(data[:2], "little"), data[2])
        return PingResult(servo_id, self.read(servo_id, RegisterName.MODEL_NUMBER, raw=True))

    @overload
    def read(self, servo_id: int, ref: RegisterRef, *, raw: Literal[True]) -> int: ...
    @overload
    def read(self, servo_id: int, ref: RegisterRef, *, raw: bool = False) -> float: ...
    def read(self, servo_id: int, ref: RegisterRef, *, raw: bool = False) -> float:
        """Return a register of one servo.

        Raises:
            BusError: No usable reply, after retries.
        """
        servo = self._require_servo(servo_id)
        register, driver = resolve_register(servo, ref), self._requester.driver_of(servo)

        def exchange() -> Reply:
            return driver.read(servo_id, register.address, register.size)

        def confirm_read(reply: Status) -> bool:
            second = exchange()
            return isinstance(second, Status) and second.data == reply.data

        confirm = confirm_read if register.steady else None
        data = self._requester.request(servo, f"read {register}", exchange, confirm=confirm)
        number = register.decode(data)
        self._track_state(servo, register, number)
        return number if raw else register.to_value(number)

    def write(self, servo_id: int, ref: RegisterRef, value: float, *, raw: bool = False) -> None:
        """Write a register of one servo and check its reply.

        A goal position is written only where torque is on, or within ``enabling``.

        Raises:
            RegisterAccessError: The register forbids it; nothing was sent.
            BusError: The servo refused, or sent no usable reply after retries.
        """
        servo = self._require_servo(servo_id)
        register, driver = resolve_register(servo, ref), self._requester.driver_of(servo)
        data = self._check_write(servo, register, value, raw=raw)
        self._check_goal(servo, register, data)
        number = register.decode(data)

        def was_written(_: Status) -> bool:
            now = driver.read(servo_id, register.address, register.size)
            return isinstance(now, Status) and now.data == data

        if register is servo.table.torque_enable:
            self._torque_on.discard(servo_id)  # until its reply says what became of it
        moves_servo = register in (servo.table.id, servo.table.baud_rate)
        self._requester.request(
            servo,
            f"write {register} = {number}",
            lambda: driver.write(servo_id, register.address, data),
            repeat=not moves_servo and (register.name, number) not in servo.table.non_idempotent,
            confirm=None if moves_servo else was_written,
        )
        self._track_state(servo, register, number)

    def reg_write(
        self, servo_id: int, ref: RegisterRef, value: float, *, raw: bool = False
    ) -> None:
        """Prepare a write that ``action`` executes; never repeated after a lost reply.

        Raises:
            RegisterAccessError: The register forbids it; nothing was sent.
            BusError: The servo refused, or sent no usable reply.
        """
        servo = self._require_servo(servo_id)
        register, driver = resolve_register(servo, ref), self._requester.driver_of(servo)
        data = self._check_write(servo, register, value, raw=raw)
        self._check_goal(servo, register, data)
        self._requester.request(
            servo,
            f"register a write of {register}",
            lambda: driver.reg_write(servo_id, register.address, data),
            repeat=False,
        )
        (self._prepared_goals.add if is_goal(servo, register) else self._prepared_goals.discard)(
            servo_id
        )  # a servo keeps the last prepared write only

    def action(self) -> None:
        """Execute the prepared writes of all servos at the same time.

        The torque of servos with a prepared goal is read first: it may have gone off since.

        Raises:
            RegisterAccessError: A goal is prepared for a servo whose torque is off now; nothing was
                executed.
            BusError: The torque of such a servo cannot be read.
        """
        for servo_id in sorted(self._prepared_goals):
            servo = self.servos[servo_id]
            if self.read(servo_id, RegisterName.TORQUE_ENABLE, raw=True) != 1:
                self._refuse_waking(servo, servo.table.goal_position)
        self._prepared_goals.clear()
        for driver in self._requester.drivers.values():
            driver.action()

    def reboot(self, servo_id: int) -> None:
        """Restart a servo; its torque is off afterwards.

        Raises:
            BusError: It refused or its family does not support reboot.
        """
        servo = self._require_servo(servo_id)
        driver = self._requester.driver_of(servo)
        self._requester.request(servo, "reboot", lambda: driver.reboot(servo_id), repeat=False)
        self._prepared_goals.discard(servo_id)
        self._torque_on.discard(servo_id)

    def is_torque_on(self, servo_id: int) -> bool:
        """Return whether a servo's torque was on when it was last read or written."""
        return servo_id in self._torque_on

    @contextlib.contextmanager
    def enabling(self, measured: Mapping[int, int]) -> Generator[None]:
        """Let goals pass to servos without torque, within the block that switches it on.

        On Feetech STS and older Dynamixel servos the goal itself switches torque on, so that it
        must be where the servo is. A servo whose torque was off, and is not on after the block,
        is switched off in case its goal has switched it on; all such are where the block fails.

        Args:
            measured: The present position of each servo, raw ticks by id, read just before, as
                its torque was.
        """
        limp = [servo_id for servo_id in measured if not self.is_torque_on(servo_id)]
        self._enabling, failed = measured, True
        try:
            yield
            failed = False
        finally:
            self._enabling = {}
            for servo_id in limp:
                if failed or not self.is_torque_on(servo_id):
                    with contextlib.suppress(BusError, PortError):
                        self.write(servo_id, RegisterName.TORQUE_ENABLE, 0, raw=True)

    def read_alarms(self, servo_id: int) -> frozenset[Alarm]:
        """Return a servo's alarms, from its alarm register or from its status packet.

        Raises:
            BusError: No usable reply, after retries.
        """
        if RegisterName.ALARMS in self._require_servo(servo_id).table.missing:
            self.ping(servo_id)
        else:
            self.read(servo_id, RegisterName.ALARMS)
        return self.alarms[servo_id]

    def _require_servo(self, servo_id: int) -> ServoSpec:
        if servo_id not in self.servos:
            known = ", ".join(str(servo) for servo in self.servos.values())
            raise BadValueError("The servo id", servo_id, f"one of {known}")
        return self.servos[servo_id]

    def _check_write(
        self, servo: ServoSpec, register: Register, value: float, *, raw: bool
    ) -> bytes:
        if register.area is Area.EEPROM and servo.id in self._torque_on:
            raise RegisterAccessError(
                str(servo), register.name, "it is in EEPROM and torque is on", "Switch torque off."
            )
        return encode_value(servo, register, value, raw=raw)

    def _check_goal(self, servo: ServoSpec, register: Register, data: bytes) -> None:
        """Refuse a goal position that could switch on the torque of a limp servo.

        Torque that is not known to be on is read.

        Raises:
            RegisterAccessError: Torque is off, and not being switched on at that position.
            BusError: The torque is not known, and the servo does not reply.
        """
        if servo.id in self._torque_on or not is_goal(servo, register):
            return
        goal_tick = register.decode(data)
        measured_tick = self._enabling.get(servo.id)
        if measured_tick is None:
            if self.read(servo.id, RegisterName.TORQUE_ENABLE, raw=True) == 1:
                return
            self._refuse_waking(servo, register)
        if abs(goal_tick - measured_tick) > MAX_ENABLING_TICKS:
            reason = f"{goal_tick} is far from {measured_tick}, where torque is switched on"
            raise RegisterAccessError(str(servo), register.name, reason)

    @staticmethod
    def _refuse_waking(servo: ServoSpec, register: Register) -> NoReturn:
        reason = "torque is off, and a goal can switch it on"
        raise RegisterAccessError(
            str(servo), register.name, reason, "Switch torque on first: torque_on()."
        )

    def _track_state(self, servo: ServoSpec, register: Register, number: int) -> None:
        """Update the known torque state or alarms from a register value."""
        if register is servo.table.torque_enable:
            (self._torque_on.add if number == 1 else self._torque_on.discard)(servo.id)
        elif RegisterName.ALARMS not in servo.table.missing and register is servo.table.alarms:
            self._requester.alarms[servo.id] = servo.table.decode_alarms(number)


_MAX_CACHED_PLANS = (
    64  # more than a program repeats; a program that never repeats must not fill memory
)

_Key = TypeVar("_Key", bound=RegisterRef)


class ServoBus(Conversation):
    """Read and write registers of the servos on one port.

    Registers may come from any table, or be a ``RegisterName``: each servo's own register so named
    is used, so that one call serves a line with several models. Values are in the register's
    unit; ``raw=True`` uses its integer, for positions the tick.

    Programs may use it without an arm; ``bulk_write``, ``broadcast_ping``, ``reg_write`` and
    ``action`` are part of this interface, though ikservo does not call them.

    Args:
        port: The port.
        servos: The expected servos, in the order of the cable.
        retries: How often a request is repeated after a lost reply.
        fast: Whether fast sync read is tried where the family supports it.

    Attributes:
        port: The port.
        servos: By id.
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
        """Return a register of many servos; see ``bulk_read``."""
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
        """Return the same registers of many servos; see ``bulk_read``."""
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
        """Read each servo's own registers, with as few requests as the family allows.

        Neighbouring registers are read together. Raises only if the port is lost. A servo that does
        not reply is in ``errors``, after one common retry of all such; one that has been silent for
        long is polled at a reduced rate.
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
                values[servo_id] |= self._decode_reply(
                    servo_id, block, step.layouts[servo_id], raw=raw
                )
        for servo_id in errors:
            del values[servo_id]
        hint = silence_hint(self.servos.values(), values, errors) if errors else ""
        alarms = {i: found for i in values if (found := self.alarms.get(i))}
        return Readings(values, errors, alarms, hint)

    def _decode_reply(
        self, servo_id: int, block: bytes, layout: ReplyLayout, *, raw: bool
    ) -> Mapping[RegisterRef, float]:
        """Return the values of a reply; update the known torque state and alarms."""
        numbers = layout.decode_raw(block)
        for key, register in layout.state_registers.items():
            self._track_state(self.servos[servo_id], register, numbers[key])
        if raw:
            return numbers
        return {key: r.to_value(numbers[key]) for key, r in layout.registers.items()}

    def sync_write(
        self, ref: RegisterRef, values: Mapping[int, float], *, raw: bool = False
    ) -> None:
        """Write a register of many servos with one packet; the protocols have no reply to it.

        Raises:
            RegisterAccessError: A register forbids its value; nothing was sent to any servo.
        """
        cells = self._write_targets(tuple(values), ref)
        rows = {
            cell.servo.id: self._encode_cell(cell, value, raw=raw)
            for cell, value in zip(cells, values.values(), strict=True)
        }
        for cell in cells:
            self._check_goal(cell.servo, cell.register, rows[cell.servo.id])
        packets: dict[Family, dict[int, tuple[int, bytes]]] = defaultdict(dict)
        for cell in cells:
            own = packets[cell.servo.table.family]
            own[cell.servo.id] = (cell.register.address, rows[cell.servo.id])
        for family, packet in packets.items():
            batch_write(self._requester.drivers[family], packet)
        for cell in cells:
            if cell.tracks_state:
                self._track_state(
                    cell.servo, cell.register, cell.register.decode(rows[cell.servo.id])
                )

    def _encode_cell(self, cell: WriteTarget, value: float, *, raw: bool) -> bytes:
        """Return the bytes of a value; the short path is for the goals of every cycle."""
        register = cell.register
        if raw and cell.plain and type(value) is int:
            lower, upper = register.range
            if lower <= value <= upper:
                return register.encode(value)
        return self._check_write(cell.servo, register, value, raw=raw)

    def _write_targets(self, ids: tuple[int, ...], ref: RegisterRef) -> Sequence[WriteTarget]:
        key = (ids, ref)
        if key not in self._writings:
            if len(self._writings) >= _MAX_CACHED_PLANS:
                self._writings.clear()
            self._writings[key] = plan_writes(map(self._require_servo, ids), ref)
        return self._writings[key]

    def bulk_write(self, values: Mapping[int, Mapping[_Key, float]], *, raw: bool = False) -> None:
        """Write each servo's own registers; the protocols have no reply to it.

        Neighbouring registers use one packet, and so do servos as far as the family allows.

        Raises:
            RegisterAccessError: A register forbids its value; nothing was sent to any servo.
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
            packets: dict[Family, dict[int, tuple[int, bytes]]] = defaultdict(dict)
            for servo_id, run in runs.items():
                family = self.servos[servo_id].table.family
                packets[family][servo_id] = (run[0].address, join_bytes(own[servo_id], run))
            for family, rows in packets.items():
                batch_write(self._requester.drivers[family], rows)
        for servo_id, row in own.items():
            for register, data in row.items():
                self._track_state(self.servos[servo_id], register, register.decode(data))

    def broadcast_ping(self, family: Family, highest_id: int | None = None) -> BroadcastPingResult:
        """Ping all servos of a family on the bus, also unknown ones.

        Args:
            family: The protocol family.
            highest_id: Up to which id to wait; the highest known one if None.

        Raises:
            PortLostError: The port is lost.
        """
        last = max(self.servos) if highest_id is None else highest_id
        return self._requester.drivers[family].broadcast_ping(last)

    def load_return_delays(self) -> None:
        """Shorten reply timeouts to these servos' own return delays.

        Until then the longest delay that the registers can hold is assumed of each servo. If one
        does not reply, the assumption stays.
        """
        readings = self.sync_read(self.servos, RegisterName.RETURN_DELAY)
        for family, driver in self._requester.drivers.items():
            ids = [i for i, servo in self.servos.items() if servo.table.family is family]
            if readings.errors.keys().isdisjoint(ids):
                driver.set_return_delay(max(readings.values[i] for i in ids))

    def reconnect(self, serial_number: str, within_s: float) -> None:
        """Reconnect after the adapter was unplugged and plugged in again; nothing moves.

        Args:
            serial_number: Of the adapter, from ``serial_number_of`` before the loss.
            within_s: How long to wait for it.

        Raises:
            PortLostError: It did not come back in time.
        """
        reconnect(self.port, serial_number, within_s)
        self._torque_on.clear()
        self.sync_read(
            self.servos, RegisterName.TORQUE_ENABLE
        )  # the servos may have been without power

    def close(self) -> None:
        """Close the port."""
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
