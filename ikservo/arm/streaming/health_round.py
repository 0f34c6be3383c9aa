"""The slow round: one question to one servo at each beat, until all have told how they are."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from ikservo.arm.streaming.asking import ask_each
from ikservo.arm.streaming.limits_in_servos import LimitsInServos
from ikservo.arm.streaming.states import JointState, load_percent
from ikservo.errors import BusError
from ikservo.guard import Health, Vitals
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.packets.block import neighbours
from ikservo.hardware.servo import ServoSpec
from ikservo.registers import Register, Role

__all__ = ["HealthRound"]

# Between two questions; where goals are streamed faster than this, not every beat has one.
_EVERY_S = 0.008
# While the program was held up nobody could be asked: no more of a cycle counts as watched.
_LONGEST_S = 0.025

_NUMBERS = (
    Role.TORQUE_ENABLE,
    Role.PRESENT_LOAD,
    Role.PRESENT_VOLTAGE,
    Role.PRESENT_TEMPERATURE,
)


class HealthRound:
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
        limits: LimitsInServos,
        health: Health,
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
    def too_hot(self) -> bool:
        """Return whether a servo was so hot that it must be let go."""
        return self._health.release

    def begin(self) -> None:
        """Ask everybody everything before a motion.

        Raises:
            BusError: A servo does not answer.
            ServoAlarmError: One is not well; see ``Health``.
            RefusedError: The watchdog of one has tripped.
        """
        self._beat_s = self._bus.clock.now_s()
        wanted = {i: self._registers(i) for i in self._names}
        self._known = {i: dict(row) for i, row in ask_each(self._bus, wanted).items()}
        runs = {i: neighbours(registers) for i, registers in wanted.items()}
        longest = max(len(r) for r in runs.values())
        self._questions = [(i, r[k]) for k in range(longest) for i, r in runs.items() if k < len(r)]
        for servo_id in self._names:
            self._judge(servo_id)

    def beat(self) -> None:
        """Ask the next question; an answer that is lost is asked for again in the next round.

        Raises:
            ServoAlarmError: A servo is not well, or was reset; see ``Health``.
            RefusedError: One has not answered how it is for too long, or its watchdog has tripped.
        """
        now_s = self._bus.clock.now_s()
        self._watched_s += min(now_s - self._beat_s, _LONGEST_S)
        self._beat_s = now_s
        if now_s - self._asked_s >= _EVERY_S:
            self._asked_s = now_s
            self._ask(*self._questions[self._next % len(self._questions)])
            self._next += 1
        for servo_id in self._names:
            if self._bus.alarms.get(servo_id):
                self._judge(servo_id)
        self._health.check(self._watched_s)

    def refreshed(self, states: Sequence[JointState]) -> tuple[JointState, ...]:
        """Return joints' states with what their servos have told since; asks nobody."""
        ids = {name: servo_id for servo_id, name in self._names.items()}
        return tuple(self._refreshed(state, ids[state.name]) for state in states)

    def _refreshed(self, state: JointState, servo_id: int) -> JointState:
        servo, known = self._bus.servos[servo_id], self._known.get(servo_id)
        if known is None:
            return state
        return replace(
            state,
            temperature_c=_value(servo, known, Role.PRESENT_TEMPERATURE),
            voltage_v=_value(servo, known, Role.PRESENT_VOLTAGE),
            load_percent=load_percent(servo, _value(servo, known, Role.PRESENT_LOAD)),
            torque=known[servo.table.torque_enable] == 1,
            alarms=tuple(sorted(str(alarm) for alarm in self._bus.alarms.get(servo_id, ()))),
        )

    def _ask(self, servo_id: int, registers: list[Register]) -> None:
        heard = self._bus.bulk_read({servo_id: registers}, raw=True).values
        if servo_id in heard:
            self._known[servo_id].update(heard[servo_id])
            self._judge(servo_id)

    def _judge(self, servo_id: int) -> None:
        vitals = self._vitals(servo_id)
        if not vitals.canary:  # a watchdog that tripped takes the limits with it, too
            self._limits.check_watchdog(servo_id)
        for warning in self._health.see(vitals):
            if warning not in self._told:
                self._told.add(warning)
                self._tell(warning)

    def _vitals(self, servo_id: int) -> Vitals:
        servo, known = self._bus.servos[servo_id], self._known[servo_id]
        expected = self._limits.canaries(servo_id)
        return Vitals(
            joint=self._names[servo_id],
            time_s=self._watched_s,
            temperature_c=_value(servo, known, Role.PRESENT_TEMPERATURE),
            voltage_v=_value(servo, known, Role.PRESENT_VOLTAGE),
            load_percent=load_percent(servo, _value(servo, known, Role.PRESENT_LOAD)),
            torque=known[servo.table.torque_enable] == 1,
            canary=all(known.get(register) == raw for register, raw in expected.items()),
            alarms=self._alarms(servo_id),
        )

    def _alarms(self, servo_id: int) -> frozenset[str]:
        """Return what a servo complains about; one whose answers only say that it does is asked."""
        if not self._bus.alarms.get(servo_id):
            return frozenset()
        with contextlib.suppress(BusError):
            self._bus.read_alarms(servo_id)
        return frozenset(str(alarm) for alarm in self._bus.alarms[servo_id])

    def _registers(self, servo_id: int) -> list[Register]:
        table = self._bus.servos[servo_id].table
        wanted = [table.find(role) for role in _NUMBERS]
        return [*wanted, *self._limits.canaries(servo_id)]


def _value(servo: ServoSpec, known: Mapping[Register, int], role: Role) -> float:
    register = servo.table.find(role)
    return register.to_value(known[register])
