"""Joint feedback: positions in every cycle, telemetry, and register reads with retries."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from ikservo.clock import Clock
from ikservo.errors import BusError, ServoSilentError
from ikservo.guard import CommunicationMonitor, DrivenJoint, TickRow
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.servo import Readings, ServoSpec
from ikservo.kinematics.arrays import Vector
from ikservo.registers import Register, RegisterName

_ATTEMPTS = 4
# Extra time after each attempt for a busy machine or a disturbed adapter.
_PAUSE_S = 0.02

_Key = TypeVar("_Key", bound=Register | RegisterName)


def read_register(bus: ServoBus, servo_ids: Iterable[int], name: RegisterName) -> dict[int, int]:
    """Read a raw register of every servo.

    Raises:
        BusError: Servos do not reply to any attempt; all of them are named.
    """
    rows = read_registers(bus, dict.fromkeys(servo_ids, (name,)))
    return {servo_id: row[name] for servo_id, row in rows.items()}


def read_registers(
    bus: ServoBus, keys_by_id: Mapping[int, Sequence[_Key]]
) -> dict[int, Mapping[_Key, int]]:
    """Read raw registers, which may differ between servos.

    Raises:
        BusError: Servos do not reply to any attempt; all of them are named.
    """
    known: dict[int, Mapping[_Key, int]] = {}
    for attempt in range(1, _ATTEMPTS + 1):
        missing = {i: keys for i, keys in keys_by_id.items() if i not in known}
        readings = bus.bulk_read(missing, raw=True)
        known |= readings.values
        if not readings.errors:
            break
        if attempt == _ATTEMPTS:
            readings.require_all()
        bus.clock.sleep_until(bus.clock.now_s() + _PAUSE_S * attempt)
    return known


def with_retries(clock: Clock, access: Callable[[], None]) -> None:
    """Access a servo while the arm is at rest; retry after a pause if the access fails.

    Raises:
        BusError: The last attempt failed.
    """
    for attempt in range(1, _ATTEMPTS):
        try:
            return access()
        except BusError:
            clock.sleep_until(clock.now_s() + _PAUSE_S * attempt)
    return access()


_MAX_LOST = 3  # number of consecutive cycles


class Feedback:
    """Reader of the joint positions.

    Args:
        bus: The servo bus.
        driven_joints: The joints, each with its servo, limits and speed.

    Attributes:
        latest: The ticks of the last cycle; None for a joint that did not reply.
    """

    def __init__(self, bus: ServoBus, driven_joints: Sequence[DrivenJoint]) -> None:
        self._bus, self._driven_joints = bus, tuple(driven_joints)
        self._ids = [driven.servo_id for driven in driven_joints]
        self._last: dict[int, int] = {}
        self.latest: TickRow = [None] * len(self._ids)
        self.reset_losses()

    def reset_losses(self) -> None:
        """Restart the count of lost replies because the arm was at rest."""
        self._losses = CommunicationMonitor(
            [driven.joint for driven in self._driven_joints], max_lost=_MAX_LOST
        )

    @property
    def lost_joints(self) -> tuple[str, ...]:
        """The joints whose last reply is missing."""
        return self._losses.lost_joints

    def measure_ticks(self) -> list[int]:
        """Read every joint's tick (n,).

        Raises:
            BusError: A servo does not reply to any attempt.
        """
        ticks = read_register(self._bus, self._ids, RegisterName.PRESENT_POSITION)
        self._last |= ticks
        self.latest = measured = [ticks[servo_id] for servo_id in self._ids]
        return measured

    def measure_positions(self) -> Vector:
        """Read the joint positions (n,), rad or m.

        Raises:
            BusError: A servo does not reply to any attempt.
        """
        self.measure_ticks()
        return self._latest_positions()

    def read(self) -> Vector:
        """Read the joints (n,); a joint without a reply keeps its last position.

        Raises:
            ServoSilentError: A servo did not reply in three consecutive cycles; it is named.
        """
        readings = self._bus.sync_read(self._ids, RegisterName.PRESENT_POSITION, raw=True)
        ticks = dict(readings.values)
        try:
            self._store_ticks(ticks)
        except ServoSilentError:
            ticks |= self._retry_silent(readings)
            self.reset_losses()
            self._store_ticks(ticks)
        return self._latest_positions()

    def _retry_silent(self, readings: Readings[int]) -> dict[int, int]:
        """Read one silent servo with all retries, because the machine may just be busy.

        Once it has replied, the other silent servos are also read again.
        """
        servo_id, *others = readings.errors
        try:
            first = {servo_id: self._bus.read(servo_id, RegisterName.PRESENT_POSITION, raw=True)}
        except BusError:
            readings.require_all()
            raise
        return first | dict(
            self._bus.sync_read(others, RegisterName.PRESENT_POSITION, raw=True).values
        )

    def _store_ticks(self, ticks: Mapping[int, int]) -> None:
        self._last |= ticks
        self.latest = [ticks.get(servo_id) for servo_id in self._ids]
        self._losses.update({d.joint for d in self._driven_joints if d.servo_id in ticks})

    def _latest_positions(self) -> Vector:
        return np.array(
            [
                driven.joint_map.position(self._last[driven.servo_id])
                for driven in self._driven_joints
            ]
        )


@dataclass(frozen=True, slots=True)
class JointState:
    """The state of one joint as reported by its servo.

    Attributes:
        position_rad: Measured position; metres for a prismatic joint.
        lower_rad: Lower limit, in the same unit.
        upper_rad: Upper limit, in the same unit.
        limit_from: The source of the limits.
        load_percent: The load as a percentage of the stall torque or, if the servo measures it, of
            the maximum current.
        torque: Whether torque is on.
        alarms: The servo's alarms.
        current_a: Current of the motor, if the servo measures it; unsigned for a Feetech servo.
            While the arm moves, it may be older than other values.
        goal_rad: The last goal sent, in the unit of the position; None if torque is off.
    """

    name: str
    position_rad: float
    lower_rad: float
    upper_rad: float
    limit_from: str
    temperature_c: float
    voltage_v: float
    load_percent: float | None
    torque: bool
    alarms: tuple[str, ...] = ()
    current_a: float | None = None
    goal_rad: float | None = None


_STATE_REGISTERS = (
    RegisterName.TORQUE_ENABLE,
    RegisterName.PRESENT_LOAD,
    RegisterName.PRESENT_VOLTAGE,
    RegisterName.PRESENT_TEMPERATURE,
)


def read_joint_states(
    bus: ServoBus, driven_joints: Sequence[DrivenJoint], ticks: Sequence[int]
) -> tuple[JointState, ...]:
    """Read limits, temperature, voltage, load and torque of joints just measured at ``ticks`` (n,).

    Raises:
        BusError: A servo does not answer.
    """
    keys: dict[int, list[Register | RegisterName]] = {}
    for driven in driven_joints:
        table = bus.servos[driven.servo_id].table
        keys[driven.servo_id] = [*_STATE_REGISTERS]
        if RegisterName.ALARMS not in table.missing:
            keys[driven.servo_id].append(RegisterName.ALARMS)
        current = table.registers.get("present_current")
        if current is not None and current is not table.present_load:
            keys[driven.servo_id].append(current)
    rows = read_registers(bus, keys)
    states: list[JointState] = []
    for driven, tick in zip(driven_joints, ticks, strict=True):
        servo, row = bus.servos[driven.servo_id], rows[driven.servo_id]
        current, current_a = servo.table.registers.get("present_current"), None
        if current is not None:
            shared = current is servo.table.present_load
            current_a = current.to_value(row[RegisterName.PRESENT_LOAD if shared else current])
        state = JointState(
            name=driven.joint,
            position_rad=driven.joint_map.position(tick),
            lower_rad=driven.limits.lower.value,
            upper_rad=driven.limits.upper.value,
            limit_from=driven.limits.source,
            temperature_c=_state_value(servo, row, RegisterName.PRESENT_TEMPERATURE),
            voltage_v=_state_value(servo, row, RegisterName.PRESENT_VOLTAGE),
            load_percent=load_percent(servo, _state_value(servo, row, RegisterName.PRESENT_LOAD)),
            torque=row[RegisterName.TORQUE_ENABLE] != 0,
            alarms=read_alarm_names(bus, driven.servo_id),
            current_a=current_a,
        )
        states.append(state)
    return tuple(states)


def read_alarm_names(bus: ServoBus, servo_id: int) -> tuple[str, ...]:
    """Read the names of a servo's alarms, because replies may only flag that there is an alarm."""
    if not bus.alarms.get(servo_id):
        return ()
    with contextlib.suppress(BusError):
        bus.read_alarms(servo_id)
    return tuple(sorted(str(alarm) for alarm in bus.alarms[servo_id]))


def _state_value(
    servo: ServoSpec, row: Mapping[Register | RegisterName, int], name: RegisterName
) -> float:
    return servo.table.find(name).to_value(row[name])


def load_percent(servo: ServoSpec, load: float) -> float:
    """Return a load in percent of the stall torque, or of the maximum current."""
    table = servo.table
    if table.present_load.unit.symbol != "A":
        return 100.0 * load
    limit = table.registers["current_limit"]
    return 100.0 * load / limit.to_value(limit.range[1])
