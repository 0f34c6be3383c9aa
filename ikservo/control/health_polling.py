"""Poll temperature, voltage, load and alarms of one servo in every cycle."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from ikservo.control.feedback import JointState, load_percent, read_registers
from ikservo.control.servo_limits import ServoRamLimits
from ikservo.errors import BusError
from ikservo.guard import HealthMonitor, ServoTelemetry
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.read_plan import contiguous_runs
from ikservo.hardware.servo import ServoSpec
from ikservo.registers import Register, RegisterName

__all__ = ["HealthPoller"]

# Between two questions; where goals are streamed faster than this, not every beat has one.
_PERIOD_S = 0.008
# While the program was held up nobody could be asked: no more of a cycle counts as watched.
_MAX_AGE_S = 0.025

_NUMBERS = (
    RegisterName.TORQUE_ENABLE,
    RegisterName.PRESENT_LOAD,
    RegisterName.PRESENT_VOLTAGE,
    RegisterName.PRESENT_TEMPERATURE,
)


class HealthPoller:
    """Asks servo after servo for its vitals and lets the guard judge them.

    Alarms come with every answer of a servo and are judged at every beat.

    Args:
        bus: The line.
        names: What each servo is called, by id: its joint, or which other servo of it.
        limits: What must stand in the servos' RAM.
        health: Judges.
        tell: Called with each new warning, in words.
    """

    def __init__(
        self,
        bus: ServoBus,
        names: Mapping[int, str],
        limits: ServoRamLimits,
        health: HealthMonitor,
        tell: Callable[[str], None],
    ) -> None:
        self._bus, self._limits, self._health, self._tell = bus, limits, health, tell
        self._names = dict(names)
        self._known: dict[int, dict[Register, int]] = {}
        self._questions: list[tuple[int, list[Register]]] = []
        self._next, self._asked_s = 0, -math.inf
        self._beat_s = self._watched_s = 0.0
        self._told: set[str] = set()

    @property
    def is_overheated(self) -> bool:
        """Return whether a servo was so hot that it must be let go."""
        return self._health.release

    def poll_all(self) -> None:
        """Ask everybody everything before a motion.

        Raises:
            BusError: A servo does not answer.
            ServoAlarmError: One is not well; see ``HealthMonitor``.
            RefusedError: The watchdog of one has tripped.
        """
        self._beat_s = self._bus.clock.now_s()
        wanted = {i: self._telemetry_registers(i) for i in self._names}
        self._known = {i: dict(row) for i, row in read_registers(self._bus, wanted).items()}
        runs = {i: contiguous_runs(registers) for i, registers in wanted.items()}
        longest = max(len(r) for r in runs.values())
        self._questions = [(i, r[k]) for k in range(longest) for i, r in runs.items() if k < len(r)]
        for servo_id in self._names:
            self._check_servo(servo_id)

    def poll(self) -> None:
        """Ask the next question; an answer that is lost is asked for again in the next round.

        Raises:
            ServoAlarmError: A servo is not well, or was reset; see ``HealthMonitor``.
            RefusedError: One has not answered how it is for too long, or its watchdog has tripped.
        """
        now_s = self._bus.clock.now_s()
        self._watched_s += min(now_s - self._beat_s, _MAX_AGE_S)
        self._beat_s = now_s
        if now_s - self._asked_s >= _PERIOD_S:
            self._asked_s = now_s
            self._read_registers(*self._questions[self._next % len(self._questions)])
            self._next += 1
        for servo_id in self._names:
            if self._bus.alarms.get(servo_id):
                self._check_servo(servo_id)
        self._health.check_telemetry_age(self._watched_s)

    def with_latest_telemetry(self, states: Sequence[JointState]) -> tuple[JointState, ...]:
        """Return joints' states with what their servos have told since; asks nobody."""
        ids = {name: servo_id for servo_id, name in self._names.items()}
        return tuple(self._refresh_state(state, ids[state.name]) for state in states)

    def _refresh_state(self, state: JointState, servo_id: int) -> JointState:
        servo, known = self._bus.servos[servo_id], self._known.get(servo_id)
        if known is None:
            return state
        return replace(
            state,
            temperature_c=_register_value(servo, known, RegisterName.PRESENT_TEMPERATURE),
            voltage_v=_register_value(servo, known, RegisterName.PRESENT_VOLTAGE),
            load_percent=load_percent(
                servo, _register_value(servo, known, RegisterName.PRESENT_LOAD)
            ),
            torque=known[servo.table.torque_enable] == 1,
            alarms=tuple(sorted(str(alarm) for alarm in self._bus.alarms.get(servo_id, ()))),
        )

    def _read_registers(self, servo_id: int, registers: list[Register]) -> None:
        heard = self._bus.bulk_read({servo_id: registers}, raw=True).values
        if servo_id in heard:
            self._known[servo_id].update(heard[servo_id])
            self._check_servo(servo_id)

    def _check_servo(self, servo_id: int) -> None:
        vitals = self._make_telemetry(servo_id)
        if not vitals.settings_intact:  # a watchdog that tripped takes the limits with it, too
            self._limits.check_watchdog(servo_id)
        for warning in self._health.update(vitals):
            if warning not in self._told:
                self._told.add(warning)
                self._tell(warning)

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
            alarms=self._read_alarms(servo_id),
        )

    def _read_alarms(self, servo_id: int) -> frozenset[str]:
        """Return what a servo complains about; one whose answers only say that it does is asked."""
        if not self._bus.alarms.get(servo_id):
            return frozenset()
        with contextlib.suppress(BusError):
            self._bus.read_alarms(servo_id)
        return frozenset(str(alarm) for alarm in self._bus.alarms[servo_id])

    def _telemetry_registers(self, servo_id: int) -> list[Register]:
        table = self._bus.servos[servo_id].table
        wanted = [table.find(role) for role in _NUMBERS]
        return [*wanted, *self._limits.reset_markers(servo_id)]


def _register_value(servo: ServoSpec, known: Mapping[Register, int], role: RegisterName) -> float:
    register = servo.table.find(role)
    return register.to_value(known[register])
