"""The servos of an arm as a group: enable torque safely, read, hold, switch torque off."""

from __future__ import annotations

import math
from collections.abc import Collection, Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial

import numpy as np

from ikservo.clock import Clock
from ikservo.control.drive_feedback import DriveReader
from ikservo.control.health_polling import HealthPoller, read_supply_ranges, read_trip_c
from ikservo.control.joint_reading import (
    Feedback,
    JointState,
    read_joint_states,
    read_register,
    read_registers,
    with_retries,
)
from ikservo.control.servo_gains import raise_gains, read_gain_shares
from ikservo.control.stillness import StillnessDetector, read_until_at_rest
from ikservo.control.stop_requests import StopOutcome, hold_servos
from ikservo.control.streamed_servos import StreamedServos
from ikservo.control.watchdog_and_torque_limits import (
    limit_torque,
    read_overload_rule,
    read_torque_share,
)
from ikservo.guard import (
    DrivenJoint,
    HealthLimits,
    HealthMonitor,
    ServoTelemetry,
    StopKind,
    StopReason,
)
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.servo import LinkStatistics
from ikservo.hardware.torque import (
    accepted_goal_range,
    check_kept_goal,
    check_supply_voltage,
    goal_range_registers,
    nearest_goal,
    torque_off,
)
from ikservo.kinematics.arrays import Vector
from ikservo.registers import RegisterName

# Longest time, in all, that an arm may sink before a motion is planned.
_SINK_TIME_S = 0.5
# Number of times that an arm which fell past its hold positions gets new ones.
_MAX_CATCHES = 3


class ServoGroup(StreamedServos):
    """Every joint's servo on one bus, in the order of ``names``.

    Args:
        bus: The servo bus.
        driven_joints: The joints, each with its servo, limits and speed.
        shadows: Ids of the additional servos of joints, by joint.
        clock: The clock of the bus.
        health: The limits on temperature, load and supply.
        gripper: The joint that may hold something, with a limited force.
    """

    def __init__(
        self,
        bus: ServoBus,
        driven_joints: Sequence[DrivenJoint],
        shadows: Mapping[str, Sequence[int]],
        clock: Clock,
        health: HealthLimits | None = None,
        gripper: str | None = None,
    ) -> None:
        super().__init__(bus, driven_joints, clock)
        self._gripper, self._sink_time_s = gripper, _SINK_TIME_S
        self._shadow_ids = {name: tuple(ids) for name, ids in shadows.items()}
        self._shadows = {i: f"{n} (servo {i})" for n in self.names for i in shadows.get(n, ())}
        self._health = HealthLimits() if health is None else health

    def enable(self, speed_rad_s: float) -> None:
        """Set each servo's goal to its position, then switch torque on: nothing moves.

        A servo that already holds keeps its goal, because load has pulled its joint slightly below
        that goal. If enabling fails, the torque of servos that were off is switched off again. Each
        horn turns at most at ``speed_rad_s``.

        Raises:
            ServoAlarmError: A servo's supply is outside its own limits; no torque was switched on.
            RefusedError: A joint is far outside its servo's limits, its servo is not in a position
                mode, or a stop was not acknowledged; no torque was switched on.
            ServoRejectedError: A servo keeps an old goal; no torque was switched on.
        """
        torque = read_register(self._bus, self._ids, RegisterName.TORQUE_ENABLE)
        self.torque.enabling(was_on=all(torque.values()))
        for driven in self.driven_joints:
            gripping = driven.joint == self._gripper and torque[driven.servo_id] != 0
            with_retries(self.clock, partial(self._prepare_servo, driven, gripping=gripping))
        self._limits.invalidate()
        self._limits.set_speed(speed_rad_s)
        start = self._switch_on(self.names)
        if not all(torque.values()):
            for _ in range(_MAX_CATCHES):  # a joint that fell past its goal holds where it is
                if wait_until_settled(self.driven_joints, start, self._feedback, self.clock):
                    break
                start = self._clamp_goals(*self._measure_hold_ticks())
                self._send(self._gate.pass_reset(start))
        names = dict(zip(self._ids, self.names, strict=True)) | self._shadows
        health = self._make_health_monitor(names)
        self._health_poller = HealthPoller(
            self._bus, names, self._limits, health, self.overload, self.log_warning
        )
        held = np.array([torque[driven.servo_id] != 0 for driven in self.driven_joints])
        self.set_reference(np.where(held, self.measure_positions(), self.goals()))
        shares = read_gain_shares(self._bus, self.driven_joints)
        self.compensator.start(shares)
        rules = {
            driven.joint: read_overload_rule(self._bus, driven.servo_id, share)
            for driven, share in zip(self.driven_joints, shares, strict=True)
        }
        self.overload.rules = {name: rule for name, rule in rules.items() if rule is not None}
        self.torque.enabled()

    def enable_joint(self, joint: str, speed_rad_s: float) -> None:
        """Switch one joint's torque on like ``enable``; the other joints stay unchanged.

        Raises:
            ServoAlarmError, RefusedError, ServoRejectedError: The errors of ``enable``.
        """
        driven = self.driven_joints[self.names.index(joint)]
        self.torque.enabling(was_on=False)  # the next motion is slow, and enables the others
        with_retries(self.clock, partial(self._prepare_servo, driven, gripping=False))
        self._limits.invalidate()
        self._limits.set_speed(speed_rad_s)
        self._switch_on((joint,))

    def disable_joint(self, joint: str) -> None:
        """Switch one joint's torque off; everything that the joint carries falls.

        Raises:
            BusError: The servo does not answer.
        """
        self.torque.releasing()
        servo_id = self._ids[self.names.index(joint)]
        for error in torque_off(self._bus, (servo_id, *self._shadow_ids.get(joint, ()))).values():
            raise error

    @contextmanager
    def tolerate_heat(self) -> Generator[None]:
        """Allow motions of an overheated arm within the block.

        An overheated arm must be lowered, and the torque of its servos then switched off.
        """
        usual, self._health = self._health, replace(self._health, hold_c=math.inf)
        try:
            yield
        finally:
            self._health = usual

    @property
    def bus(self) -> ServoBus:
        """The servos' bus, for registers that motions do not use."""
        return self._bus

    @property
    def overheated(self) -> bool:
        """Whether a servo was too hot to continue holding in the last motion."""
        return self._health_poller is not None and self._health_poller.is_overheated

    def measured_hold_positions(self) -> Vector:
        """Read the start (n,) of a motion after ``enable``, rad or m, without writing anything.

        The start is the measured position; a gripper that already holds keeps its goal, because it
        may press on something. The method waits until a sinking arm is at rest.

        Raises:
            BusError: A servo does not answer.
            RefusedError: A joint is far outside its servo's limits.
        """
        if self._sink_time_s > 0.0 and not self.read_torque_on():
            since_s = self.clock.now_s()
            wait_until_still(self.driven_joints, self._feedback, self.clock, self._sink_time_s)
            self._sink_time_s -= self.clock.now_s() - since_s
        held = self._to_positions(self._clamp_goals(*self._measure_hold_ticks()))
        return np.where(self.compensator.corrects, self.measure_positions(), held)

    def read_torque_on(self) -> bool:
        """Read whether every servo's torque is on."""
        return all(read_register(self._bus, self._ids, RegisterName.TORQUE_ENABLE).values())

    def disable_torque(self) -> None:
        """Switch torque off on every servo, even if some fail.

        Raises:
            BusError: The first failure; all servos were tried.
        """
        self._sink_time_s = _SINK_TIME_S
        self.torque.releasing()
        failures = torque_off(self._bus, (*self._ids, *self._shadows))
        for error in failures.values():
            raise error
        self.torque.released()

    def reconnect(self, serial_number: str, within_s: float) -> None:
        """Open the port again once its adapter is back, and stay stopped; see ``Arm.reconnect``."""
        self.torque.reconnected()
        self._bus.reconnect(serial_number, within_s)
        self.latch_stop(StopReason(StopKind.UNPLUGGED, "device unplugged"))
        self._feedback.measure_ticks()

    def hold_measured(self, reason: StopReason) -> StopOutcome:
        """Latch a stop and hold the measured positions, while no control loop runs.

        Servos that another program was moving stop; torque is not changed.
        """
        self.latch_stop(reason)
        return hold_servos(self._bus, self.driven_joints, self.clock)

    def limit_force(self, joint: str, fraction: float) -> None:
        """Limit the torque of a joint's servo until its torque is switched on again.

        Raises:
            RegisterAccessError: The servo has no such limit.
        """
        servo_id = self._ids[self.names.index(joint)]
        limit_torque(self._bus, servo_id, fraction)
        if joint in self.overload.rules:
            share = read_torque_share(self._bus, servo_id)
            rule = replace(self.overload.rules[joint], torque_limit=share)
            self.overload.rules[joint] = rule

    def check_goal(self, positions: Vector, start: Vector) -> None:
        """Check the final goal (n,) of a motion from ``start`` (n,) before it begins.

        Raises:
            RefusedError: A joint would leave its limits.
        """
        self._gate.check_range(self._to_ticks(positions), self._to_ticks(start))

    def with_latest_telemetry(self, states: tuple[JointState, ...]) -> tuple[JointState, ...]:
        """Return joint states with the latest telemetry of the motion, without reading a servo."""
        return self._health_poller.with_latest_telemetry(states) if self._health_poller else states

    def link_statistics(self) -> LinkStatistics:
        """Return round-trip time and losses of the line, without reading a servo."""
        return LinkStatistics.of(self._bus.statistics.values())

    def profile_speeds(self, horn_rad_s: float) -> Vector:
        """Return the speeds of joints (n,) to each goal, rad/s or m/s, at a speed of the horns."""
        return np.array([
            driven.joint_map.unit_per_horn_rad
            * self._limits.profile_speed_rad_s(driven.servo_id, horn_rad_s)
            for driven in self.driven_joints
        ])  # fmt: skip

    def drive_reader(self, names: Sequence[str]) -> DriveReader:
        """Return a reader for duty, current and supply of the servos of given joints."""
        driven_joints = {driven.joint: driven for driven in self.driven_joints}
        return DriveReader(
            self._bus, [(driven_joints[n], self._shadow_ids.get(n, ())) for n in names]
        )

    def read_states(self) -> tuple[JointState, ...]:
        """Read every joint's position, limits, temperature, voltage, load and torque."""
        ticks, now_s = self._feedback.measure_ticks(), self.clock.now_s()
        states = read_joint_states(self._bus, self.driven_joints, ticks)
        if not self.torque.is_moving:
            rows = zip(states, ticks, strict=True)
            held = [tick if state.torque else None for state, tick in rows]
            for warning in self.overload.update(self._gate.goals, held, now_s):
                self.log_warning(warning)
        return states

    def check_health(self) -> None:
        """Check that no servo reports a state that would end a motion at once.

        Raises:
            ServoAlarmError: A servo reports an alarm, is too hot, or its supply is out of range.
        """
        names = {driven.servo_id: driven.joint for driven in self.driven_joints}
        now_s, monitor = self.clock.now_s(), self._make_health_monitor(names)
        for state in self.read_states():
            monitor.update(
                ServoTelemetry(
                    state.name,
                    now_s,
                    state.temperature_c,
                    state.voltage_v,
                    state.load_percent,
                    torque=True,  # it will be on
                    settings_intact=True,
                    alarms=frozenset(state.alarms),
                )
            )

    def _make_health_monitor(self, names: Mapping[int, str]) -> HealthMonitor:
        supplies, limits_c = read_supply_ranges(self._bus, names), read_trip_c(self._bus, names)
        return HealthMonitor(self._health, supplies, limits_c)

    def _switch_on(self, joints: Collection[str]) -> list[int]:
        """Switch torque on with goals at the joint positions; return the goals of all joints."""
        ticks, ranges = self._measure_hold_ticks()
        start = self._clamp_goals(ticks, ranges)
        chosen = [i for i, name in enumerate(self.names) if name in joints]
        self._gate.check_stop()
        with self._bus.enabling({self._ids[i]: ticks[i] for i in chosen}):
            row = [tick if i in chosen else None for i, tick in enumerate(start)]
            self._send(self._gate.pass_reset(row))
            verify_goals(self._bus, {self._ids[i]: start[i] for i in chosen})
            for i in chosen:
                switch_on = partial(
                    self._bus.write, self._ids[i], RegisterName.TORQUE_ENABLE, 1, raw=True
                )
                with_retries(self.clock, switch_on)
        return start

    def _prepare_servo(self, driven: DrivenJoint, *, gripping: bool) -> None:
        """Prepare one servo to hold; a servo that may grip something keeps its torque limit."""
        check_supply_voltage(self._bus, driven.servo_id)
        self._limits.prepare(driven.servo_id, keep_torque=gripping)
        raise_gains(self._bus, driven.servo_id, gripper=driven.joint == self._gripper)

    def _measure_hold_ticks(self) -> tuple[list[int], list[tuple[int, int]]]:
        """Read the goal range that each servo accepts, then its hold position.

        Positions are measured last, because limp joints fall.
        """
        servos = [self._bus.servos[servo_id] for servo_id in self._ids]
        held = read_registers(self._bus, {s.id: goal_range_registers(s.table) for s in servos})
        ranges = [accepted_goal_range(servo, held[servo.id]) for servo in servos]
        return hold_ticks(self._bus, self.driven_joints, self._feedback), ranges

    def _clamp_goals(self, ticks: Sequence[int], ranges: Sequence[tuple[int, int]]) -> list[int]:
        rows = zip(self.names, ticks, ranges, strict=True)
        return [nearest_goal(joint, tick, accepted) for joint, tick, accepted in rows]


# An arm whose torque comes on while it falls swings faster than two ticks in 30 ms.
_HELD = StillnessDetector(window_s=0.03, tolerance=2, least_readings=2)
_MAX_WAIT_S = 1.0  # limit of the wait for rest
# A limp arm sinks more slowly: at rest, only noise moves a joint.
_LIMP = StillnessDetector(window_s=0.05, tolerance=1, least_readings=2)
_FALLS_RAD = 0.01  # a horn that turns by more between two readings falls


def hold_ticks(
    bus: ServoBus, driven_joints: Sequence[DrivenJoint], feedback: Feedback
) -> list[int]:
    """Read the tick at which each joint holds, or would hold when its torque comes on.

    A servo that already holds keeps its goal: its joint sags slightly, and holding the measured
    tick would sag further. An outdated goal that is far from the joint is not kept.

    Raises:
        BusError: A servo does not answer.
    """
    ids = [driven.servo_id for driven in driven_joints]
    torque = read_register(bus, ids, RegisterName.TORQUE_ENABLE)
    goals = read_register(bus, ids, RegisterName.GOAL_POSITION)
    present = feedback.measure_ticks()  # last, because limp joints fall
    held: list[int] = []
    for driven, tick in zip(driven_joints, present, strict=True):
        goal, (low, high) = goals[driven.servo_id], driven.tick_range
        is_near = abs(goal - tick) <= driven.max_lead_ticks(0.0)
        # A goal of another program may be outside the limits, but not further than its joint.
        inside = min(max(goal, min(low, tick)), max(high, tick))
        held.append(inside if torque[driven.servo_id] != 0 and is_near else tick)
    return held


def wait_until_settled(
    driven_joints: Sequence[DrivenJoint], goals: Sequence[int], feedback: Feedback, clock: Clock
) -> bool:
    """Wait until the joints are at rest near their goals after torque came on.

    Returns:
        Whether the joints are at rest; False if one second was not enough.
    """

    def has_settled(still: StillnessDetector) -> bool:
        return still.is_at_rest() and all(
            abs(goal - tick) <= driven.max_lead_ticks(0.0)
            for driven, goal, tick in zip(driven_joints, goals, still.joints, strict=True)
        )

    read = feedback.measure_ticks
    return has_settled(read_until_at_rest(_HELD, read, clock, _MAX_WAIT_S, has_settled))


def wait_until_still(
    driven_joints: Sequence[DrivenJoint], feedback: Feedback, clock: Clock, timeout_s: float
) -> None:
    """Wait until a sinking limp arm is at rest, so that plans start from its final position.

    If the arm falls, the wait ends at once, because torque must come on. The wait also ends after
    ``timeout_s``, because a hand may be moving the arm.

    Raises:
        BusError: A servo does not answer.
    """

    def rests_or_falls(still: StillnessDetector) -> bool:
        return still.is_at_rest() or any(
            ticks * driven.joint_map.horn_rad_per_tick > _FALLS_RAD
            for driven, ticks in zip(driven_joints, still.variations(), strict=True)
        )

    read_until_at_rest(_LIMP, feedback.measure_ticks, clock, timeout_s, rests_or_falls)


def verify_goals(bus: ServoBus, expected: Mapping[int, int]) -> None:
    """Read goals back before torque comes on, because a stale goal would make a joint jump.

    Raises:
        ServoRejectedError: A servo still holds a different goal; torque stays off.
    """
    goals = read_register(bus, expected, RegisterName.GOAL_POSITION)
    for servo_id, goal in goals.items():
        check_kept_goal(bus, servo_id, goal, expected[servo_id])
