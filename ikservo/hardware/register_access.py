"""Access to registers of single servos; goals are refused while torque is off."""

from __future__ import annotations

import contextlib
from collections.abc import Generator, Mapping, Sequence
from typing import Literal, NoReturn, Protocol, overload

from ikservo.clock import Clock
from ikservo.errors import BadValueError, BusError, PortError, RegisterAccessError
from ikservo.hardware.packets import Reply, Status
from ikservo.hardware.port import Port
from ikservo.hardware.register_batches import RegisterRef, encode_value, is_goal, resolve_register
from ikservo.hardware.requester import Requester
from ikservo.hardware.servo import PingResult, ServoSpec, ServoStatistics
from ikservo.registers import Alarm, Area, Register, RegisterName

MAX_ENABLING_TICKS = 170
"""Largest distance between a goal and a servo's position at which torque is switched on [tick].

A joint that is slightly outside its servo's limits moves back inside; a joint further outside is on
another revolution and would turn all the way back.
"""


class StopListening(Protocol):
    """Receiver of the stops that other programs send to a bus."""

    def check_may_move(self) -> None:
        """Raise ``StoppedError`` if another program has stopped this one."""
        ...

    def close(self) -> None:
        """Stop listening."""
        ...


class RegisterAccess:
    """Read and write registers of single servos; ``ServoBus`` adds group operations.

    Args:
        port: The port.
        servos: The expected servos, in their order along the cable.
        retries: The number of repetitions of a request after a lost reply.
        fast: Whether fast sync read is tried if the family supports it.

    Attributes:
        statistics: The reply statistics of each servo.
        alarms: The alarms in the latest reply of each servo that has replied.
        backup_owner: Name of the folder for EEPROM backups; if empty, no backups are made.
    """

    def __init__(
        self, port: Port, servos: Sequence[ServoSpec], *, retries: int = 2, fast: bool = True
    ) -> None:
        self.port = port
        self.servos: Mapping[int, ServoSpec] = {servo.id: servo for servo in servos}
        self._requester = Requester(port, servos, retries, fast=fast)
        self.statistics: Mapping[int, ServoStatistics] = self._requester.statistics
        self.alarms: Mapping[int, frozenset[Alarm]] = self._requester.alarms
        self.backup_owner = ""
        self._torque_on: set[int] = set()
        self.stop_listener: StopListening | None = None
        self._enabling: Mapping[int, int] = {}
        self._prepared_goals = set[int]()

    @property
    def clock(self) -> Clock:
        """The clock of the line; virtual if the servos are simulated."""
        return self.port.clock

    def ping(self, servo_id: int) -> PingResult:
        """Return the identity that a servo reports.

        Raises:
            BusError: The servo does not reply, or its reply is invalid.
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
        """Read a register of one servo.

        Raises:
            BusError: There was no usable reply, after retries.
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
        """Write a register of one servo and check the servo's reply.

        A goal position is written only if torque is on, or in a block of ``enabling``.

        Raises:
            RegisterAccessError: The register forbids the write; nothing was sent.
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
            self._torque_on.discard(servo_id)  # the state is unknown until the reply confirms it
        moves_servo = register in (servo.table.id, servo.table.baud_rate)
        self._requester.request(
            servo,
            f"write {register} = {number}",
            lambda: driver.write(servo_id, register.address, data),
            repeat=not moves_servo and (register.name, number) not in servo.table.non_idempotent,
            confirm=None if moves_servo else was_written,
        )
        self._track_state(servo, register, number)

    def write_until_power_off(self, servo_id: int, register: Register, raw: int) -> None:
        """Write a register with immediate effect, even under torque, without storing it.

        A Feetech servo accepts a number for its EEPROM while the EEPROM is locked, and loses the
        number at power-off (memory tables, register ``lock``).

        Raises:
            RegisterAccessError: The register forbids the write, or the number would be stored.
            BusError: The servo refused, or sent no usable reply after retries.
        """
        servo = self._require_servo(servo_id)
        lock = servo.table.eeprom_lock
        if register.area is not Area.EEPROM:
            self.write(servo_id, register, raw, raw=True)
            return
        if lock is None or not self.read(servo_id, lock, raw=True):
            raise RegisterAccessError(str(servo), register.name, "the EEPROM would store the value")
        data = encode_value(servo, register, raw, raw=True)
        driver = self._requester.driver_of(servo)
        what = f"write {register} = {raw}"
        self._requester.request(servo, what, lambda: driver.write(servo_id, register.address, data))

    def reg_write(
        self, servo_id: int, ref: RegisterRef, value: float, *, raw: bool = False
    ) -> None:
        """Prepare a write that ``action`` executes; never repeated after a lost reply.

        Raises:
            RegisterAccessError: The register forbids the write; nothing was sent.
            BusError: The servo refused, or sent no usable reply.
        """
        servo = self._require_servo(servo_id)
        register, driver = resolve_register(servo, ref), self._requester.driver_of(servo)
        data = self._check_write(servo, register, value, raw=raw)
        self._check_goal(servo, register, data)
        what = f"register a write of {register}"
        self._requester.request(
            servo, what, lambda: driver.reg_write(servo_id, register.address, data), repeat=False
        )
        if is_goal(servo, register):
            self._prepared_goals.add(servo_id)
        else:  # a servo keeps only the last prepared write
            self._prepared_goals.discard(servo_id)

    def action(self) -> None:
        """Execute the prepared writes of all servos at the same time.

        The torque of servos with a prepared goal is read first, because it may be off by now.

        Raises:
            RegisterAccessError: A goal is prepared for a servo whose torque is off now; nothing was
                executed.
            BusError: The torque state of such a servo cannot be read.
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
            BusError: The servo refused or its family does not support reboot.
        """
        servo = self._require_servo(servo_id)
        driver = self._requester.driver_of(servo)
        self._requester.request(servo, "reboot", lambda: driver.reboot(servo_id), repeat=False)
        self._prepared_goals.discard(servo_id)
        self._torque_on.discard(servo_id)

    def factory_reset(self, servo_id: int) -> None:
        """Give a servo its factory settings except its id; its torque is off afterwards.

        Raises:
            BusError: The servo refused, or its family cannot keep its id.
        """
        servo = self._require_servo(servo_id)
        driver = self._requester.driver_of(servo)
        self.write(servo_id, RegisterName.TORQUE_ENABLE, 0, raw=True)
        self._requester.request(
            servo, "reset to factory settings", lambda: driver.factory_reset(servo_id), repeat=False
        )

    def is_torque_on(self, servo_id: int) -> bool:
        """Check whether a servo's torque was on when it was last read or written."""
        return servo_id in self._torque_on

    def check_may_move(self) -> None:
        """Raise an error if another program has stopped this one; torque must then stay off.

        Raises:
            StoppedError: Another program has stopped this one.
        """
        if self.stop_listener is not None:
            self.stop_listener.check_may_move()

    @contextlib.contextmanager
    def enabling(self, measured: Mapping[int, int]) -> Generator[None]:
        """Allow goals for servos without torque in the block, which switches torque on.

        On Feetech STS and older Dynamixel servos the goal itself switches torque on, so it must be
        the servo's position. If a servo's torque was off and is not known to be on after the block,
        it is switched off, in case the goal switched it on; if the block fails, this is done for
        all servos whose torque was off. ``measured`` are raw ticks by id, read just before the
        block, together with the torque.

        Raises:
            StoppedError: Another program has stopped this one; see ``check_may_move``.
        """
        self.check_may_move()
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
        """Read a servo's alarms, from its alarm register or from its status packet.

        Raises:
            BusError: There was no usable reply, after retries.
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
        """Refuse a goal position that could switch on the torque of a servo.

        Torque is read if it is not known to be on.

        Raises:
            RegisterAccessError: Torque is off, or is being switched on far from the goal position.
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
            reason = f"{goal_tick} is too far from {measured_tick}, where torque is switched on"
            raise RegisterAccessError(str(servo), register.name, reason)

    @staticmethod
    def _refuse_waking(servo: ServoSpec, register: Register) -> NoReturn:
        reason = "torque is off, and a goal can switch it on"
        raise RegisterAccessError(
            str(servo), register.name, reason, "Switch torque on first: torque_on()."
        )

    def _track_state(self, servo: ServoSpec, register: Register, number: int) -> None:
        """Update the known torque state, or the known alarms, from a register value."""
        if register is servo.table.torque_enable:
            (self._torque_on.add if number == 1 else self._torque_on.discard)(servo.id)
        elif RegisterName.ALARMS not in servo.table.missing and register is servo.table.alarms:
            self._requester.alarms[servo.id] = servo.table.decode_alarms(number)
