"""Poll temperature, voltage, load and alarms of one servo per cycle, and of all before a motion."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from ikservo.clock import Clock
from ikservo.control.joint_reading import (
    JointState,
    load_percent,
    read_alarm_names,
    read_register,
    read_registers,
)
from ikservo.control.watchdog_and_torque_limits import ServoRamLimits
from ikservo.errors import HeldUpError
from ikservo.guard import HealthMonitor, OverloadMonitor, ServoTelemetry
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.register_batches import batches
from ikservo.hardware.servo import ServoSpec
from ikservo.registers import Register, RegisterName

# Time between two reads of telemetry; if cycles are shorter, not every cycle has a read.
_PERIOD_S = 0.008
# A cycle ages telemetry by at most this time, because a delayed program could not read anything.
_MAX_AGE_S = 0.025

_NUMBERS = (
    RegisterName.TORQUE_ENABLE,
    RegisterName.PRESENT_LOAD,
    RegisterName.PRESENT_VOLTAGE,
    RegisterName.PRESENT_TEMPERATURE,
)


class HealthPoller:
    """Reader of one servo's telemetry after another, for the guard's health monitor.

    Alarms are part of every reply and are checked in every cycle.

    Args:
        bus: The servo bus.
        names: Names of the servos by id: the joint and, for an additional servo, its id.
        limits: The expected limits in the servos' RAM.
        health: Checks the telemetry.
        overload: Receives each load reading, or each current if the servo's protection uses it.
        on_warning: Called with each new warning.
    """

    def __init__(
        self,
        bus: ServoBus,
        names: Mapping[int, str],
        limits: ServoRamLimits,
        health: HealthMonitor,
        overload: OverloadMonitor,
        on_warning: Callable[[str], None],
    ) -> None:
        self._bus, self._limits, self._health = bus, limits, health
        self._overload, self._on_warning = overload, on_warning
        self._names = dict(names)
        self._known: dict[int, dict[Register, int]] = {}
        self._requests: list[tuple[int, list[Register]]] = []
        self._next, self._polled_s = 0, -math.inf
        self._cycle_s = self._watched_s = 0.0
        self._warned: set[str] = set()

    @property
    def is_overheated(self) -> bool:
        """Whether a servo was too hot to continue holding."""
        return self._health.release

    def poll_all(self) -> None:
        """Read all telemetry of all servos before a motion.

        Raises:
            BusError: A servo does not answer.
            ServoAlarmError: A servo reports a fault; see ``HealthMonitor``.
            RefusedError: The watchdog of a servo has tripped.
        """
        self._cycle_s = self._bus.clock.now_s()
        registers: dict[int, list[Register]] = {}
        for servo_id in self._names:
            table, counted = self._bus.servos[servo_id].table, self._counted_current(servo_id)
            registers[servo_id] = [table.find(name) for name in _NUMBERS]
            if counted and counted not in registers[servo_id]:
                registers[servo_id].append(counted)
            registers[servo_id] += self._limits.reset_markers(servo_id)
        self._known = {i: dict(row) for i, row in read_registers(self._bus, registers).items()}
        self._requests = [request for runs in batches(registers) for request in runs.items()]
        for servo_id in self._names:
            self._check_servo(servo_id)

    def poll(self) -> None:
        """Read the next registers; a lost reply is read again in the next round.

        Raises:
            ServoAlarmError: A servo reports a fault, or was reset; see ``HealthMonitor``.
            RefusedError: The telemetry of a servo is too old, or its watchdog has tripped.
        """
        now_s = self._bus.clock.now_s()
        self._watched_s += min(now_s - self._cycle_s, _MAX_AGE_S)
        self._cycle_s = now_s
        if now_s - self._polled_s >= _PERIOD_S:
            self._polled_s = now_s
            self._read_registers(*self._requests[self._next % len(self._requests)])
            self._next += 1
        for servo_id in self._names:
            if self._bus.alarms.get(servo_id):
                self._check_servo(servo_id)
        self._health.check_telemetry_age(self._watched_s)

    def poll_round(self) -> None:
        """Read all telemetry of all servos once; if a reply is lost, the old values stay.

        Raises:
            ServoAlarmError: A servo reports a fault, or was reset; see ``HealthMonitor``.
            RefusedError: The watchdog of a servo has tripped.
        """
        for servo_id, registers in self._requests:
            self._read_registers(servo_id, registers)

    def with_latest_telemetry(self, states: Sequence[JointState]) -> tuple[JointState, ...]:
        """Return joint states with the latest telemetry, without reading a servo."""
        ids, latest = {name: servo_id for servo_id, name in self._names.items()}, list(states)
        for i, state in enumerate(states):
            servo_id = ids[state.name]
            servo, known = self._bus.servos[servo_id], self._known.get(servo_id)
            if known is None:
                continue
            register = servo.table.present_load
            load, is_current = register.to_value(known[register]), register.unit.symbol == "A"
            latest[i] = replace(
                state,
                temperature_c=_register_value(servo, known, RegisterName.PRESENT_TEMPERATURE),
                voltage_v=_register_value(servo, known, RegisterName.PRESENT_VOLTAGE),
                load_percent=load_percent(servo, load),
                torque=known[servo.table.torque_enable] == 1,
                alarms=tuple(sorted(str(alarm) for alarm in self._bus.alarms.get(servo_id, ()))),
                current_a=load if is_current else state.current_a,
            )
        return tuple(latest)

    def _read_registers(self, servo_id: int, registers: list[Register]) -> None:
        values = self._bus.bulk_read({servo_id: registers}, raw=True).values
        if servo_id in values:
            self._known[servo_id].update(values[servo_id])
            self._check_servo(servo_id)
            name, now_s = self._names[servo_id], self._bus.clock.now_s()
            counted = self._counted_current(servo_id)
            load = counted or self._bus.servos[servo_id].table.present_load
            if load in values[servo_id]:
                value = load.to_value(values[servo_id][load])
                if counted:
                    self._overload.observe_current(name, value, now_s)
                elif load.unit.symbol != "A":
                    self._overload.observe_load(name, value, now_s)

    def _check_servo(self, servo_id: int) -> None:
        telemetry = self._make_telemetry(servo_id)
        if not telemetry.settings_intact:  # a tripped watchdog resets the limits, too
            self._limits.check_watchdog(servo_id)
        for warning in self._health.update(telemetry):
            if warning not in self._warned:
                self._warned.add(warning)
                self._on_warning(warning)

    def _make_telemetry(self, servo_id: int) -> ServoTelemetry:
        servo, known = self._bus.servos[servo_id], self._known[servo_id]
        expected = self._limits.reset_markers(servo_id)
        return ServoTelemetry(
            joint=self._names[servo_id],
            time_s=self._watched_s,
            temperature_c=_register_value(servo, known, RegisterName.PRESENT_TEMPERATURE),
            voltage_v=_register_value(servo, known, RegisterName.PRESENT_VOLTAGE),
            load_percent=load_percent(
                servo, _register_value(servo, known, RegisterName.PRESENT_LOAD)
            ),
            torque=known[servo.table.torque_enable] == 1,
            settings_intact=all(known.get(register) == raw for register, raw in expected.items()),
            alarms=frozenset(read_alarm_names(self._bus, servo_id)),
        )

    def _counted_current(self, servo_id: int) -> Register | None:
        """Return the current register of a servo if its protection uses the current."""
        rule = self._overload.rules.get(self._names[servo_id])
        registers = self._bus.servos[servo_id].table.registers
        return registers.get("present_current") if rule and rule.full_a else None


def _register_value(servo: ServoSpec, known: Mapping[Register, int], name: RegisterName) -> float:
    register = servo.table.find(name)
    return register.to_value(known[register])


def read_supply_ranges(bus: ServoBus, names: Mapping[int, str]) -> dict[str, tuple[float, float]]:
    """Read the supply limits [V] of each servo, by its name.

    Raises:
        BusError: A servo does not answer.
    """
    low = read_register(bus, names, RegisterName.MIN_VOLTAGE_LIMIT)
    high = read_register(bus, names, RegisterName.MAX_VOLTAGE_LIMIT)
    ranges: dict[str, tuple[float, float]] = {}
    for servo_id, name in names.items():
        table = bus.servos[servo_id].table
        min_v = table.find(RegisterName.MIN_VOLTAGE_LIMIT).to_value(low[servo_id])
        max_v = table.find(RegisterName.MAX_VOLTAGE_LIMIT).to_value(high[servo_id])
        ranges[name] = (min_v, max_v)
    return ranges


def read_trip_c(bus: ServoBus, names: Mapping[int, str]) -> dict[str, float]:
    """Read the temperature [°C] at which each servo protects itself, by its name.

    Raises:
        BusError: A servo does not answer.
    """
    raw = read_register(bus, names, RegisterName.MAX_TEMPERATURE_LIMIT)
    limits = {i: bus.servos[i].table.find(RegisterName.MAX_TEMPERATURE_LIMIT) for i in names}
    return {name: limits[i].to_value(raw[i]) for i, name in names.items()}


_WATCHDOG_DELAY_S = 0.08  # longest time to arm all watchdogs: the first watchdog trips after 0.1 s
_ATTEMPTS = 10  # largest number of attempts to arm them in this time


def prepare_servos(
    limits: ServoRamLimits, health_poller: HealthPoller | None, clock: Clock, horn_rad_s: float
) -> float:
    """Set limits, arm watchdogs and read all telemetry; repeat this if it took too long.

    A watchdog that trips in the meantime resets the limits. The poller is None until torque is
    first switched on.

    Returns:
        The start time of the first cycle; any pause after this time counts for the cycle.

    Raises:
        BusError: A servo does not answer.
        ServoAlarmError: A servo reports a fault.
        HeldUpError: The program was delayed in every attempt.
    """

    def arm_watchdogs() -> float:
        limits.set_speed(horn_rad_s)
        since_s = clock.now_s()
        limits.arm_watchdog()
        if health_poller:
            health_poller.poll_all()
        return since_s

    for _ in range(_ATTEMPTS):
        with contextlib.suppress(HeldUpError):  # a watchdog has tripped already
            since_s = arm_watchdogs()
            if clock.now_s() - since_s < _WATCHDOG_DELAY_S or not limits.watchdog_ids:
                return since_s
        limits.disarm_watchdog()
        limits.invalidate()
    arm_watchdogs()
    return clock.now_s()  # the bus is too slow for the watchdogs
