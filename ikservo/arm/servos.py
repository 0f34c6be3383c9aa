"""The arm's servos as one body: measured joints out, goals in through the guard."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ikservo.arm.reports import JointState
from ikservo.arm.starting import confirm_goals, nearest_goal
from ikservo.clock import Clock
from ikservo.guard import Fence, Gate
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.torque import check_supply, torque_off
from ikservo.kinematics.se3 import Vector
from ikservo.registers import Alarm, Role

__all__ = ["Servos"]

# A holding servo sags under its load by less than this; a goal further away is a stale one.
_STALE_GOAL_TICKS = 64
_TIME_BASED_PROFILE = 0b100  # drive mode of Dynamixel X


class Servos:
    """Every joint's servo on one bus, in the order of ``names``.

    Args:
        bus: The line.
        fences: What each joint's servo may be told.
        shadows: Servo ids that turn a joint besides, by joint.
        clock: The line's time.
    """

    def __init__(
        self,
        bus: ServoBus,
        fences: Sequence[Fence],
        shadows: Mapping[str, Sequence[int]],
        clock: Clock,
    ) -> None:
        self._bus, self.clock = bus, clock
        self.fences = tuple(fences)
        self.names = tuple(fence.joint for fence in fences)
        self._ids = [fence.servo_id for fence in fences]
        self._shadow_ids = [i for name in self.names for i in shadows.get(name, ())]
        self._gate = Gate(fences, self._write_goals, clock)

    def measure(self) -> Vector:
        """Return where the joints are (n,), rad or m, from the servos' own registers."""
        return self._positions(self._present_ticks())

    def goals(self) -> Vector:
        """Return where the servos were last told to go (n,), rad or m."""
        return self._positions(self._gate.goals)

    def enable(self, speed_rad_s: float) -> None:
        """Switch torque on without a twitch: each servo's goal is where it is, then torque.

        A servo that already holds keeps its goal, for its load has pulled it a little below.

        Args:
            speed_rad_s: The fastest each servo's horn may turn by itself.

        Raises:
            ServoAlarmError: A servo's supply is outside its own limits; no torque was switched.
            RefusedError: A joint stands far outside what its servo allows; likewise.
            ServoRefusedError: A servo keeps an old goal; likewise.
        """
        for fence in self.fences:
            check_supply(self._bus, fence.servo_id)
        holding = self._torque()
        present, goals = self._present_ticks(), self._goal_ticks()
        start = {
            f.joint: nearest_goal(
                self._bus, f, _start_tick(holding[f.joint], present[f.joint], goals[f.joint])
            )
            for f in self.fences
        }
        self._gate.start_from(start)
        confirm_goals(self._bus, {fence.servo_id: start[fence.joint] for fence in self.fences})
        for fence in self.fences:
            self._limit_speed(fence.servo_id, speed_rad_s)
            self._bus.write(fence.servo_id, Role.TORQUE_ENABLE, 1, raw=True)

    def release(self) -> None:
        """Switch torque off on every servo, also when some fail.

        Raises:
            BusError: The first failure, after all were tried.
        """
        failures = torque_off(self._bus, (*self._ids, *self._shadow_ids))
        for error in failures.values():
            raise error

    def command(self, positions: Vector) -> None:
        """Send goals (n,), rad or m, through the guard.

        Raises:
            RefusedError: The guard will not pass them; nothing was sent.
        """
        self._gate.send(self._ticks(positions))

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

    def states(self) -> tuple[JointState, ...]:
        """Return every joint's position, limits, temperature, voltage, load and torque."""
        positions, torque = self.measure(), self._torque()
        temperatures = self._ask(Role.PRESENT_TEMPERATURE)
        voltages, loads = self._ask(Role.PRESENT_VOLTAGE), self._ask(Role.PRESENT_LOAD)
        alarms = self._alarms()
        return tuple(
            JointState(
                name=fence.joint,
                position_rad=float(positions[i]),
                lower_rad=fence.limits.lower.value,
                upper_rad=fence.limits.upper.value,
                limit_from=fence.limits.source,
                temperature_c=temperatures[fence.servo_id],
                voltage_v=voltages[fence.servo_id],
                load_percent=self._percent(fence.servo_id, loads[fence.servo_id]),
                torque=torque[fence.joint],
                alarms=tuple(sorted(str(alarm) for alarm in alarms.get(fence.servo_id, ()))),
            )
            for i, fence in enumerate(self.fences)
        )

    def _limit_speed(self, servo_id: int, speed_rad_s: float) -> None:
        """Bound how fast a servo turns towards its goal by itself."""
        drive_mode = self._bus.servos[servo_id].table.registers.get("drive_mode")
        if drive_mode and self._bus.read(servo_id, drive_mode, raw=True) & _TIME_BASED_PROFILE:
            # Such a servo is told how long a step takes, not how fast; 0 leaves the steps to us.
            self._bus.write(servo_id, Role.PROFILE_VELOCITY, 0, raw=True)
        else:
            self._bus.write(servo_id, Role.PROFILE_VELOCITY, speed_rad_s)

    def _write_goals(self, goals: Mapping[int, int]) -> None:
        self._bus.sync_write(Role.GOAL_POSITION, goals, raw=True)

    def _present_ticks(self) -> dict[str, int]:
        return self._by_joint(self._ask_raw(Role.PRESENT_POSITION))

    def _goal_ticks(self) -> dict[str, int]:
        return self._by_joint(self._ask_raw(Role.GOAL_POSITION))

    def _torque(self) -> dict[str, bool]:
        raw = self._by_joint(self._ask_raw(Role.TORQUE_ENABLE))
        return {name: value != 0 for name, value in raw.items()}

    def _ask(self, role: Role) -> Mapping[int, float]:
        return self._bus.sync_read(self._ids, role).complete()

    def _ask_raw(self, role: Role) -> Mapping[int, int]:
        return self._bus.sync_read(self._ids, role, raw=True).complete()

    def _alarms(self) -> Mapping[int, frozenset[Alarm]]:
        return self._bus.sync_read(self._ids, Role.ALARMS, raw=True).alarms

    def _percent(self, servo_id: int, load: float) -> float:
        """Return a load as a share of the most there is: of torque, or of the current limit."""
        table = self._bus.servos[servo_id].table
        if table.present_load.unit.symbol != "A":
            return 100.0 * load
        most = table.registers["current_limit"]
        return 100.0 * load / most.to_value(most.range[1])

    def _by_joint(self, by_id: Mapping[int, int]) -> dict[str, int]:
        return {fence.joint: by_id[fence.servo_id] for fence in self.fences}

    def _ticks(self, positions: Vector) -> dict[str, int]:
        return {
            fence.joint: fence.tick(float(position))
            for fence, position in zip(self.fences, positions, strict=True)
        }

    def _positions(self, ticks: Mapping[str, int]) -> Vector:
        return np.array([f.joint_map.position(ticks[f.joint]) for f in self.fences])


def _start_tick(holding: bool, present: int, goal: int) -> int:
    return goal if holding and abs(goal - present) <= _STALE_GOAL_TICKS else present
