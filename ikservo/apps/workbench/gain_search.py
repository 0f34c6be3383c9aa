"""Measure the response of a servo to a quick motion, and search for better gains."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from ikservo.apps.workbench.tried_values import forget_former, note_former, restore_former
from ikservo.arm.arm import Arm
from ikservo.control.loop import ControlCycle
from ikservo.control.stop_requests import exiting_on_signals
from ikservo.errors import BadValueError, BlockedError, InputError, RefusedError, UnknownNameError
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.servo import ServoSpec
from ikservo.kinematics.arrays import FrozenArrays, Vector
from ikservo.motion import JointMove, KinematicLimits, Trajectory, TrajectoryPoint
from ikservo.planning.context import ArmContext
from ikservo.registers import Register

DEFAULT_STEP_RAD = float(np.radians(10.0))
REST_S = 1.0  # rest after a motion
_JUDGED_S = 0.5  # last part of a rest, in which a joint should be still
_LEAST_STEP_RAD = np.radians(1.0) - 1e-9
_SETTLED_RAD = np.radians(0.2)
_SWINGING_RAD = np.radians(0.25)
_TRIED = ("i_gain", "position_i_gain", "min_startup_force", "cw_dead_zone", "ccw_dead_zone")
_GAIN_NAMES = (("p_gain", "position_p_gain"), ("d_gain", "position_d_gain"))
_P_FACTORS, _D_FACTORS, _FINE_FACTORS = (0.7, 1.4, 2.0, 2.8, 4.0), (0.5, 2.0, 4.0), (0.7, 1.4)
_Motion = TypeVar("_Motion", bound=Trajectory)
_Tried = TypeVar("_Tried")
_FRACTIONS = (32, 16, 8)  # divisors of the highest gain, tried if the present gain is 0


@dataclass(frozen=True, slots=True, eq=False)
class StepResponse(FrozenArrays):
    """Response of a joint to a quick motion back and forth, without corrections by ikservo.

    Attributes:
        time_s: Times (m,) since the start.
        goal_rad: The goals of the servo (m,).
        position_rad: Measured positions (m,).
        ends_s: End times of the two motions.
    """

    time_s: Vector
    goal_rad: Vector
    position_rad: Vector
    ends_s: tuple[float, float]

    @property
    def overshoot_rad(self) -> float:
        """Largest overshoot beyond the rest position, in the direction of the motion."""
        return 0.0 + max(float(beyond.max(initial=0.0)) for beyond in self._beyond_rest())

    @property
    def settling_s(self) -> float:
        """Longest time after the goals until the joint stays within 0.2° of its rest position."""
        longest_s = 0.0
        for beyond, end_s in zip(self._beyond_rest(), self.ends_s, strict=True):
            time_s = self.time_s[self._rest(end_s)]
            away = np.flatnonzero(np.abs(beyond) > _SETTLED_RAD)
            longest_s = max(longest_s, float(time_s[away[-1]] - end_s) if away.size else 0.0)
        return longest_s

    @property
    def steady_error_rad(self) -> float:
        """Largest distance between the rest position and the goal."""
        rows = (self._judged(end_s) for end_s in self.ends_s)
        return max(abs(float(np.mean(self.goal_rad[r] - self.position_rad[r]))) for r in rows)

    @property
    def swing_rad(self) -> float:
        """Largest peak-to-peak motion in the last half second of a rest."""
        return max(
            swing_at_rest(self.time_s, self.position_rad, end_s + REST_S) for end_s in self.ends_s
        )

    @property
    def lag_s(self) -> float:
        """Lag behind the goals while they move, as a time."""
        speed = np.gradient(self.goal_rad, self.time_s)
        fast = np.abs(speed) > 0.7 * np.abs(speed).max(initial=1e-9)
        behind = (self.goal_rad - self.position_rad)[fast]
        return float(np.sum(behind * np.sign(speed[fast])) / np.sum(np.abs(speed[fast])))

    @property
    def swings(self) -> bool:
        """Whether the joint does not come to rest."""
        return self.swing_rad > _SWINGING_RAD

    @property
    def overshoots(self) -> bool:
        """Whether the joint overshoots its rest position by more than the tolerance."""
        return self.overshoot_rad > _SETTLED_RAD

    @property
    def cost(self) -> float:
        """Cost of the gains: 1 per degree of error and per 0.2 s of settling, 10 for swinging."""
        far = np.degrees(self.overshoot_rad + self.steady_error_rad)
        return float(far + self.settling_s / 0.2 + (10.0 if self.swings else 0.0))

    def _judged(self, end_s: float) -> slice:
        return _rows_between(self.time_s, end_s + REST_S - _JUDGED_S, end_s + REST_S)

    def _rest(self, end_s: float) -> slice:
        return _rows_between(self.time_s, end_s, end_s + REST_S)

    def _beyond_rest(self) -> list[Vector]:
        """Return the distances of the joint beyond its rest position, after each motion."""
        there_rad = self.goal_rad[self._rest(self.ends_s[0])][0] - self.goal_rad[0]
        sign = 1.0 if there_rad > 0 else -1.0
        return [
            direction * (self.position_rad[self._rest(end_s)]
                         - np.mean(self.position_rad[self._judged(end_s)]))
            for direction, end_s in zip((sign, -sign), self.ends_s, strict=True)
        ]  # fmt: skip


class _ThereAndBack:
    """Motion of a joint to a goal and back, with a rest after each."""

    def __init__(self, start: Vector, goal: Vector, limits: Sequence[KinematicLimits]) -> None:
        self._there, self._back = JointMove(start, goal, limits), JointMove(goal, start, limits)
        self.start = start
        self.ends_s = (
            self._there.duration_s,
            self._there.duration_s + REST_S + self._back.duration_s,
        )
        self.duration_s = self.ends_s[1] + REST_S

    def state(self, time_s: float) -> TrajectoryPoint:
        """Return position, velocity and acceleration (n,) at a time."""
        back_s = self._there.duration_s + REST_S
        if time_s < back_s:
            return self._there.state(min(time_s, self._there.duration_s))
        return self._back.state(min(time_s - back_s, self._back.duration_s))


def measure_response(arm: Arm, joint: str, step_rad: float) -> StepResponse:
    """Move a joint back and forth at the speed ``fast``, and return the response of its servo.

    ikservo's own corrections are off, so that only the servo with its gains is measured. The other
    joints hold; the step is reversed if there is no room.

    Raises:
        BadValueError: The step is smaller than 1°.
        RefusedError: There is no room, or something is in the way; nothing moved.
        IkservoError: The errors of every motion; see ``Arm``.
    """
    if not abs(step_rad) >= _LEAST_STEP_RAD:
        raise BadValueError("The step", f"{np.degrees(step_rad):.3g}°", "at least 1°")
    context, column = arm.context, arm.context.index.names.index(joint)
    lower, upper = context.limits()
    at_rad = context.servos.measure_positions()[column]
    moves_rad = [move for move in (step_rad, -step_rad)
                 if lower[column] <= at_rad + move <= upper[column]]  # fmt: skip
    if not moves_rad:
        raise RefusedError(
            f"{joint} has no room for {abs(np.degrees(step_rad)):.0f}°.",
            "Move it away from its limits, or choose a smaller --step.",
        )
    limits = context.planner.motion_limits("fast")
    ends_s: list[float] = []

    def make_motion(start: Vector) -> Trajectory:
        motions = [_ThereAndBack(start, start + move * (np.arange(len(start)) == column), limits)
                   for move in moves_rad]  # fmt: skip
        motion = find_free_motion(context, motions)
        ends_s.extend(motion.ends_s)
        return motion

    return StepResponse(*record_joint(arm, column, make_motion), (ends_s[0], ends_s[1]))


def find_free_motion(context: ArmContext, motions: Sequence[_Motion]) -> _Motion:
    """Return the first of several motions that is free of obstacles.

    Raises:
        RefusedError: None of the motions is free.
    """
    *others, last = motions
    for motion in others:
        with contextlib.suppress(RefusedError):
            context.check_streamed_path(motion, "fast")
            return motion
    try:
        context.check_streamed_path(last, "fast")
    except BlockedError as error:
        hint = "Move the arm to a pose with more room around it, or choose a smaller step."
        raise RefusedError(error.message, hint) from error
    return last


def record_joint(
    arm: Arm, column: int, make_motion: Callable[[Vector], Trajectory]
) -> tuple[Vector, Vector, Vector]:
    """Run a motion without ikservo's corrections; return times, goals, positions (m,) of a joint.

    The times increase: of several cycles at the same time of the motion, the last one is used.

    Raises:
        IkservoError: The errors of every motion; see ``Arm``.
    """
    rows: dict[float, tuple[float, float]] = {}

    def record(cycle: ControlCycle) -> None:
        rows[cycle.time_s] = float(cycle.goals[column]), float(cycle.measured[column])

    arm.runner.run(make_motion, record, "fast", compensated=False)
    time_s, (goals, positions) = np.array(list(rows)), np.array(list(rows.values())).T
    return time_s, goals, positions


def swing_at_rest(time_s: Vector, position_rad: Vector, end_s: float) -> float:
    """Compute the peak-to-peak motion of a joint in the last half second of a rest."""
    return float(np.ptp(position_rad[_rows_between(time_s, end_s - _JUDGED_S, end_s)]))


def _rows_between(time_s: Vector, start_s: float, end_s: float) -> slice:
    """Return the rows from one time to another, at least one."""
    first, last = np.searchsorted(time_s, (start_s, end_s))
    return slice(int(first), max(int(last), int(first) + 1))


def gain_registers(servo: ServoSpec) -> tuple[Register, Register]:
    """Return the registers of the P and the D gain of a servo's position loop.

    Raises:
        RefusedError: The servo's model has no such gains.
    """
    registers = servo.table.registers
    found = [registers[name] for names in _GAIN_NAMES for name in names if name in registers]
    if len(found) != len(_GAIN_NAMES):
        raise RefusedError(
            f"{servo} is a {servo.table.model_name}, which has no P and D gains.",
            "Its compliance registers can be set: ikservo servo table",
        )
    return found[0], found[1]


def tunable_registers(servo: ServoSpec) -> list[Register]:
    """Return the registers to try: P, D, I, and Feetech's start-up force and dead zones.

    Raises:
        RefusedError: The servo's model has no P and D gain.
    """
    registers = servo.table.registers
    return [*gain_registers(servo), *(registers[name] for name in _TRIED if name in registers)]


def find_turning_servo(arm: Arm, joint: str) -> ServoSpec:
    """Return the servo of a joint of the chain, by the joint's name or the servo's id.

    Raises:
        UnknownNameError: There is no such joint.
        InputError: The joint moves the jaws.
    """
    servos = list(arm.context.servos.bus.servos.values())
    found = [each for each in servos if joint in (each.name, str(each.id))]
    if not found:
        raise UnknownNameError("joint", joint, [each.name for each in servos])
    if found[0].name not in arm.chain.names:
        raise InputError(f"{found[0]} does not move the tip.", "Choose a joint that does.")
    return found[0]


@contextlib.contextmanager
def keeping_gains(
    bus: ServoBus, servo: ServoSpec, tried: Iterable[Register] = ()
) -> Generator[Mapping[Register, int]]:
    """Yield the present gains, and restore them after the ``with`` block, even after an error.

    Besides P and D, the registers in ``tried`` are restored.
    """
    restore_former(bus, servo)  # values that a killed program has left
    kept = dict.fromkeys([*gain_registers(servo), *tried])
    before = {each: bus.read(servo.id, each, raw=True) for each in kept}
    note_former(bus, servo, before)
    try:
        yield before
    finally:
        try:
            write_gains(bus, servo, before)
        except BaseException:  # such as a second Ctrl-C
            write_gains(bus, servo, before)
            forget_former(bus, servo)
            raise
        forget_former(bus, servo)


def write_gains(bus: ServoBus, servo: ServoSpec, gains: Mapping[Register, int]) -> None:
    """Write gains, which last until the servo's power goes off; torque stays on.

    Raises:
        RegisterAccessError: A number is outside its range.
        BusError: The servo does not reply.
    """
    for register, raw in gains.items():
        bus.write_until_power_off(servo.id, register, raw)


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """Gains that were tried, and the response of the servo."""

    gains: Mapping[Register, int]
    response: StepResponse


def search_gains(arm: Arm, servo: ServoSpec, before: Trial, step_rad: float) -> Generator[Trial]:
    """Try gains on a joint: P, then D with the best P, then P nearby; yield each trial.

    A gain is not raised beyond a value at which the joint swings. Of two gains with equal costs,
    the lower one is better. If a joint does not overshoot, lower P is not tried, because under a
    load it would lag so far that the guard stops it.
    """
    best, bus = before, arm.context.servos.bus
    p_gain, d_gain = gain_registers(servo)
    tried: set[tuple[int, int]] = {(before.gains[p_gain], before.gains[d_gain])}
    for register, factors in ((p_gain, _P_FACTORS), (d_gain, _D_FACTORS), (p_gain, _FINE_FACTORS)):
        present, (lower, upper) = best.gains[register], register.range
        if register is p_gain and not (before.response.swings or before.response.overshoots):
            lower = before.gains[register]
        if before.gains[register]:
            upper = min(upper, round(_P_FACTORS[-1] * before.gains[register]))
        wanted = [f * present for f in factors] if present else [upper / n for n in _FRACTIONS]
        for raw in sorted({min(max(round(each), lower, 1), upper) for each in wanted}):
            gains = {**best.gains, register: raw}
            pair = gains[p_gain], gains[d_gain]
            if pair in tried:
                continue
            tried.add(pair)
            write_gains(bus, servo, gains)
            trial = Trial(gains, measure_response(arm, servo.name, step_rad))
            yield trial
            if trial.response.cost < best.response.cost:
                best = trial
            elif trial.response.swings and raw > best.gains[register]:
                break


def best_trial(trials: Sequence[Trial]) -> Trial:
    """Return the trial with the best response; the first one if several are equal."""
    return min(trials, key=lambda one: one.response.cost)


def try_gains(
    arm: Arm,
    servo: ServoSpec,
    given: Mapping[Register, int],
    try_one: Callable[[Mapping[Register, int]], _Tried],
    search: Callable[[Sequence[_Tried]], Iterable[_Tried]] | None = None,
) -> list[_Tried]:
    """Return trials of the present gains, of the given gains, and of gains from a search.

    The present gains are restored at the end, even after an error.
    """
    bus = arm.context.servos.bus
    with exiting_on_signals(), keeping_gains(bus, servo, given) as present:
        tried = [try_one(present)]
        if given:
            gains = {**present, **given}
            write_gains(bus, servo, gains)
            tried.append(try_one(gains))
        return [*tried, *search(tried)] if search else tried


def try_steps(
    arm: Arm, servo: ServoSpec, given: Mapping[Register, int], step_rad: float, *, suggest: bool
) -> list[Trial]:
    """Return step responses with the present gains, the given gains, and gains from a search.

    Raises:
        IkservoError: The errors of ``measure_response``; the present gains are restored.
    """

    def try_one(gains: Mapping[Register, int]) -> Trial:
        return Trial(gains, measure_response(arm, servo.name, step_rad))

    def search(trials: Sequence[Trial]) -> Iterable[Trial]:
        return search_gains(arm, servo, best_trial(trials), step_rad) if suggest else ()

    return try_gains(arm, servo, given, try_one, search)
