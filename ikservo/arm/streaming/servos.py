"""The arm's servos as one body: torque, health and reach, besides what is streamed to them."""

from __future__ import annotations

import math
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial

from ikservo.arm.owner.halting import Halted, hold_servos
from ikservo.arm.skills.force import limit_force
from ikservo.arm.streaming.asking import ask_all, patiently
from ikservo.arm.streaming.halt import StopKind, StopReason
from ikservo.arm.streaming.health_round import HealthRound
from ikservo.arm.streaming.starting import (
    await_rest,
    await_still,
    confirm_goals,
    goals_taken,
    holding_ticks,
    nearest_goal,
)
from ikservo.arm.streaming.states import JointState, read_states
from ikservo.arm.streaming.stiffness import stiffen
from ikservo.arm.streaming.streamed import StreamedServos
from ikservo.clock import Clock
from ikservo.guard import Fence, Health, HealthLimits
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.torque import check_supply, torque_off
from ikservo.kinematics.se3 import Vector
from ikservo.registers import Role

__all__ = ["Servos"]

# How long an arm that sinks is waited for, in all, before it is planned for.
_SINKS_S = 0.5
# An arm that fell past the goals at which it was to be caught gets new ones so often.
_CATCHES = 3


class Servos(StreamedServos):
    """Every joint's servo on one bus, in the order of ``names``.

    Args:
        bus: The line.
        fences: What each joint's servo may be told.
        shadows: Servo ids that turn a joint besides, by joint.
        clock: The line's time.
        health: What a servo may be asked to bear.
        gripper: The joint that may hold something, with no more force than a person said.
    """

    def __init__(
        self,
        bus: ServoBus,
        fences: Sequence[Fence],
        shadows: Mapping[str, Sequence[int]],
        clock: Clock,
        health: HealthLimits | None = None,
        gripper: str | None = None,
    ) -> None:
        super().__init__(bus, fences, clock)
        self._gripper, self._patience_s = gripper, _SINKS_S
        self._shadows = {i: f"{n} (servo {i})" for n in self.names for i in shadows.get(n, ())}
        self._health = HealthLimits() if health is None else health

    def enable(self, speed_rad_s: float) -> None:
        """Switch torque on without a twitch: each servo's goal is where it is, then torque.

        A servo that already holds keeps its goal, for its load has pulled it a little below.

        Args:
            speed_rad_s: The fastest each servo's horn may turn by itself.

        Raises:
            ServoAlarmError: A servo's supply is outside its own limits; no torque was switched.
            RefusedError: A joint stands far outside what its servo allows, or the arm was stopped
                and nobody has acknowledged it; likewise.
            ServoRefusedError: A servo keeps an old goal; likewise.
        """
        torque = ask_all(self._bus, self._ids, Role.TORQUE_ENABLE)
        self.torque.enabling(was_on=all(torque.values()))
        for fence in self.fences:
            grips = fence.joint == self._gripper and torque[fence.servo_id] != 0
            patiently(self.clock, partial(self._prepare, fence, grips=grips))
        self._limits.forget()
        self._limits.run_at(speed_rad_s)
        start = self._start_ticks()
        self._gate.start_from(start)
        confirm_goals(self._bus, {fence.servo_id: start[fence.joint] for fence in self.fences})
        for fence in self.fences:
            switch_on = partial(self._bus.write, fence.servo_id, Role.TORQUE_ENABLE, 1, raw=True)
            patiently(self.clock, switch_on)
        if not all(torque.values()):
            self._catch(start)
        if self._cycle_time_s is None:  # not before: a limp arm would sink meanwhile
            self.measure_cycle_time_s()
        names = dict(zip(self._ids, self.names, strict=True)) | self._shadows
        health = Health(self._health, self._supply_v(names))
        self._round = HealthRound(self._bus, names, self._limits, health, self._warn)
        self.torque.enabled()

    @contextmanager
    def bearing_heat(self) -> Generator[None]:
        """Let heat alone stop no motion for which torque is switched on meanwhile.

        A servo that is too hot to go on must be let go, and before that the arm must come down.
        """
        usual, self._health = self._health, replace(self._health, hold_c=math.inf)
        try:
            yield
        finally:
            self._health = usual

    @property
    def too_hot(self) -> bool:
        """Return whether a servo was so hot in the last motion that it must be let go."""
        return self._round is not None and self._round.too_hot

    def standing(self) -> Vector:
        """Return where ``enable`` would let the joints hold (n,), rad or m; nothing is written.

        That is where they are, or the goals of those that hold already: load has pulled such a
        joint below its goal, and a motion begins at the goal. An arm that sinks is waited for.

        Raises:
            BusError: A servo does not answer.
            RefusedError: A joint stands far outside what its servo allows.
        """
        if self._patience_s > 0.0 and not self.read_torque_on():
            since_s = self.clock.now_s()
            await_still(self.fences, self._feedback, self.clock, self._patience_s)
            self._patience_s -= self.clock.now_s() - since_s
        return self._positions(self._start_ticks())

    def read_torque_on(self) -> bool:
        """Read whether every servo's torque is on."""
        return all(ask_all(self._bus, self._ids, Role.TORQUE_ENABLE).values())

    def release(self) -> None:
        """Switch torque off on every servo, also when some fail.

        Raises:
            BusError: The first failure, after all were tried.
        """
        self._patience_s = _SINKS_S
        self.torque.releasing()
        failures = torque_off(self._bus, (*self._ids, *self._shadows))
        for error in failures.values():
            raise error
        self.torque.released()

    def reconnect(self, serial_number: str, within_s: float) -> None:
        """Open the line again once its adapter is back, and stay stopped; see ``Arm.reconnect``."""
        self.torque.reconnected()
        self._bus.reopen(serial_number, within_s)
        self._gate.latch_stop(StopReason(StopKind.UNPLUGGED, "device unplugged"))
        self._feedback.ticks()

    def hold_measured(self, reason: StopReason) -> Halted:
        """Latch a stop and hold where the joints are measured, while no control loop runs.

        Servos that another program has set in motion are stopped; torque is not switched.
        """
        self._gate.latch_stop(reason)
        return hold_servos(self._bus, self.fences, self.clock)

    def limit_force(self, joint: str, share: float) -> None:
        """Limit how hard a joint's servo may press until its torque is switched on anew.

        Raises:
            RegisterAccessError: The servo has no such limit.
        """
        limit_force(self._bus, self._ids[self.names.index(joint)], share)

    def check(self, positions: Vector, start: Vector) -> None:
        """Check a distant goal (n,) before a motion to it from ``start`` (n,) begins.

        Raises:
            RefusedError: A joint would leave its limits.
        """
        self._gate.check_range(self._ticks(positions), self._ticks(start))

    def nearest(self, positions: Vector) -> Vector:
        """Return the positions (n,) that the guard would pass, nearest to the given ones."""
        ticks = self._ticks(positions)
        return self._positions({name: self._gate.nearest(name, ticks[name]) for name in ticks})

    def refreshed(self, states: tuple[JointState, ...]) -> tuple[JointState, ...]:
        """Return joints' states with what their servos have told in motion since; asks nobody."""
        return self._round.refreshed(states) if self._round else states

    def states(self) -> tuple[JointState, ...]:
        """Return every joint's position, limits, temperature, voltage, load and torque."""
        return read_states(self._bus, self.fences, self._feedback.ticks())

    def _catch(self, start: dict[str, int]) -> None:
        """Wait until all joints stand near their goals; where one fell past, it holds there."""
        for _ in range(_CATCHES):
            if await_rest(self.fences, start, self._feedback, self.clock):
                return
            start = self._start_ticks()
            self._gate.start_from(start)

    def _prepare(self, fence: Fence, *, grips: bool) -> None:
        """Make one servo ready to hold.

        Args:
            fence: Of its joint.
            grips: Whether it may hold something now; its torque limit then stays as it is.
        """
        check_supply(self._bus, fence.servo_id)
        self._limits.prepare(fence.servo_id, keep_torque=grips)
        stiffen(self._bus, fence.servo_id, jaws=fence.joint == self._gripper)

    def _start_ticks(self) -> dict[str, int]:
        """Return where each servo shall hold; the joints are measured last, for limp ones fall."""
        taken = {f.joint: goals_taken(self._bus, f.servo_id) for f in self.fences}
        ticks = holding_ticks(self._bus, self.fences, self._feedback)
        return {f.joint: nearest_goal(f, ticks[f.joint], taken[f.joint]) for f in self.fences}

    def _supply_v(self, names: Mapping[int, str]) -> dict[str, tuple[float, float]]:
        """Return by what a servo is called what it says that it may be fed with, volts."""
        low = ask_all(self._bus, list(names), Role.MIN_VOLTAGE_LIMIT)
        high = ask_all(self._bus, list(names), Role.MAX_VOLTAGE_LIMIT)
        return {name: self._volts(servo_id, low, high) for servo_id, name in names.items()}

    def _volts(
        self, servo_id: int, low: Mapping[int, int], high: Mapping[int, int]
    ) -> tuple[float, float]:
        table = self._bus.servos[servo_id].table
        least = table.find(Role.MIN_VOLTAGE_LIMIT).to_value(low[servo_id])
        return least, table.find(Role.MAX_VOLTAGE_LIMIT).to_value(high[servo_id])

    def _warn(self, words: str) -> None:
        self.warn(words)
