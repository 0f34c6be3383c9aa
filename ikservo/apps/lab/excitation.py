"""Excite an arm for identification by a tour of postures: plan, check and record the tour."""

from __future__ import annotations

from bisect import bisect
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, count, islice, pairwise

import numpy as np
from numpy.typing import NDArray

from ikservo.apps.lab.drive_recording import DriveRecording, smooth_samples
from ikservo.apps.lab.parameter_estimation import gravity_columns
from ikservo.arm.motion_runner import MotionRunner
from ikservo.control.loop import ControlCycle
from ikservo.errors import RefusedError
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.dynamics import Dynamics
from ikservo.model.joint_drive import joint_drive
from ikservo.model.load_lag import sustained_lag
from ikservo.motion import JointMove, KinematicLimits
from ikservo.motion.trajectory import TrajectoryPoint
from ikservo.planning.context import ArmContext

_CANDIDATES, _MAX_DRAWS = 12, 400
_SEED = 1
_CLEARANCE_M = 0.02  # required clearance of the body
_LIMIT_MARGIN = 0.05  # margin at both ends, as a fraction of the range of a joint
# The motions are slow, but goals may lead loaded joints by as much as in a normal motion. The
# servos move to each goal slowly, because bursts increase the mean friction of their gears.
_SPEED_CLASS, _PROFILE_CLASS = "normal", "slow"
_LEAD_SHARE = 0.75  # fraction of the lead that the guard allows
_HALVINGS = 30
_HEAVIER = 1.4  # factor for links heavier than in the arm file, or with a payload
_PATH_STEP = 10  # gravity is evaluated at every tenth sample of a path
_MAX_WAY = 1.5  # largest motion of a joint between two postures, rad
_PAUSE_S, _TURN_S = 0.3, 0.05  # pauses in every posture, and between two swings
_SLOW = 0.3  # speed of the last part of a tour, as a fraction of the class
# Least period of readings, in s and in cycles: a reading delays the goal after it.
_READ_PERIOD_S, _READ_CYCLES = 0.01, 2.5
_PHASE_SHARE, _GOLDEN = 0.7, 0.6180339887498949  # readings are spread over this part of the cycle
# Half a servo loop until a goal takes effect, and half a loop of age of a measured value.
_SERVO_LOOP_S = 0.001
_SWING_RAD = 0.07  # amplitude of a swing at the horn
# Draws for the upright posture: first anywhere, then around the best ones in ever smaller spreads.
_UPRIGHT_DRAWS, _UPRIGHT_SPREADS, _UNLOADED_SHARE = 1200, (0.1, 0.03, 0.01, 0.003), 0.01
_PRIOR = 1e-3  # prior, as a fraction of the largest information; favours new directions


@dataclass(frozen=True, slots=True)
class TourOptions:
    """Length of a tour.

    Attributes:
        postures: The number of its postures.
        slow_postures: The number of postures that are visited again, more slowly.
        swings: The number of swings of each joint alone, where gravity hardly loads it; they reveal
            its backlash.
    """

    postures: int = 8
    slow_postures: int = 3
    swings: int = 4


@dataclass(frozen=True, slots=True, eq=False)
class ExcitationLeg:
    """A motion between two postures that starts at ``start_s``, after a pause."""

    start_s: float
    move: JointMove

    @property
    def end_s(self) -> float:
        """Time at which the motion ends."""
        return self.start_s + self.move.duration_s


class Excitation:
    """A tour of postures as one trajectory, with a pause in each posture.

    Args:
        waypoints: The postures (k, n), rad or m, the start first.
        limits: The kinematic joint limits for each motion between two postures.
        pauses_s: The pause before each motion, and a pause after the last motion.
    """

    def __init__(
        self,
        waypoints: Sequence[Vector],
        limits: Sequence[Sequence[KinematicLimits]],
        pauses_s: Sequence[float],
    ) -> None:
        self._waypoints, self._limits, self._pauses_s = list(waypoints), list(limits), pauses_s
        self.legs: list[ExcitationLeg] = []
        at_s = 0.0
        for (start, end), own, pause_s in zip(pairwise(waypoints), limits, pauses_s, strict=True):
            leg = ExcitationLeg(at_s + pause_s, JointMove(start, end, own))
            self.legs.append(leg)
            at_s = leg.end_s
        self._ends_s = [leg.end_s for leg in self.legs]
        self.start, self.duration_s = waypoints[0], at_s + _PAUSE_S

    def starting_at(self, start: Vector) -> Excitation:
        """Return the tour with another start (n,) near the present one."""
        return Excitation([start, *self._waypoints[1:]], self._limits, self._pauses_s)

    def state(self, time_s: float) -> TrajectoryPoint:
        """Return position, velocity and acceleration (n,) at a time."""
        leg = self.legs[self.leg_at(time_s)]
        return leg.move.state(time_s - leg.start_s)

    def leg_at(self, time_s: float) -> int:
        """Compute the index of the leg at a time; a leg includes the pause before it."""
        return min(bisect(self._ends_s, time_s), len(self.legs) - 1)

    def moving(self, time_s: float) -> NDArray[np.intp]:
        """Compute the columns of the joints that move in the leg at a time."""
        leg = self.leg_at(time_s)
        return np.flatnonzero(self._waypoints[leg + 1] != self._waypoints[leg])


def plan_excitation(
    context: ArmContext, dynamics: Dynamics, start: Vector, options: TourOptions | None = None
) -> Excitation:
    """Plan a tour of postures whose gravity torques identify the masses.

    Postures are drawn within the limits, with room around the body and free paths between them. Of
    several, the one that adds the most information about the masses is taken (D-optimality).
    The tour runs at the speed ``slow`` back and forth, because friction shows as the difference
    between both directions; a part of the tour is repeated more slowly. It starts and ends at the
    joints ``start`` (n,), rad or m.

    Raises:
        RefusedError: There is no free path from the start to any posture.
    """
    options = options or TourOptions()
    there = _draw_postures(context, dynamics, start, options.postures)[1:]
    slow = there[: options.slow_postures]
    tour = [start, *there, *reversed(there[:-1]), *slow[1:], *reversed(slow[:-1]), start]
    usual = context.planner.motion_limits("slow")
    slower = [KinematicLimits(_SLOW * x.speed_rad_s, x.acceleration_rad_s2, x.jerk_rad_s3)
              for x in usual]  # fmt: skip
    first_slow = 2 * len(there) - 1
    limits = [slower if k >= first_slow else usual for k in range(len(tour) - 1)]
    swings = _swings(context, dynamics, start, options.swings)
    tour += [*swings, start] if swings else []
    pauses_s = [_PAUSE_S] * len(limits) + [_TURN_S] * (len(tour) - 1 - len(limits))
    limits += [usual] * (len(tour) - 1 - len(limits))
    excitation = Excitation(tour, limits, pauses_s)
    context.check_streamed_path(excitation, "slow")
    return excitation


def _draw_postures(
    context: ArmContext, dynamics: Dynamics, start: Vector, most: int
) -> list[Vector]:
    """Return the start and the postures (n,) of a tour, each reachable from the previous one."""
    random, space = np.random.default_rng(_SEED), _FreeSpace.of(context, dynamics, start)
    postures, way = [start], [start]
    # Information of the postures about the scale of each mass and the payload.
    information = np.zeros((len(dynamics.bodies) + 1,) * 2)
    while way and len(postures) <= most:
        candidates = list(islice(space.reachable_postures(way[-1], random), _CANDIDATES))
        if candidates:
            sums: list[Matrix] = []
            for q in candidates:
                torques = gravity_columns(dynamics, context.index.chain_joints(q)[None])[0]
                sums.append(information + torques.T @ torques)
            best = int(np.argmax([_determinant(each) for each in sums]))
            information = sums[best]
            way.append(candidates[best])
        else:  # go back along the free path
            way.pop()
        postures += way[-1:]
    if len(postures) == 1:
        hint = "Clear the space around it, or move it to another pose first: ikservo pose home"
        raise RefusedError("The arm has no room to move.", hint)
    return postures


def _swings(context: ArmContext, dynamics: Dynamics, start: Vector, times: int) -> list[Vector]:
    """Return reachable postures (n,) between which joints swing one by one; empty if none fit.

    Gears cross their backlash where the load changes its sign. Gravity does not load the joints of
    an upright arm, whatever its links weigh.
    """
    space = _FreeSpace.of(context, dynamics, start)
    for upright in space.upright_postures(start, np.random.default_rng(_SEED)) if times else ():
        ways = np.diag(
            [driven.joint_map.unit_per_horn_rad for driven in context.servos.driven_joints]
        )
        ends = [(upright + way, upright - way) for way in _SWING_RAD * ways[[*context.index.chain]]]
        if all(space.is_way_free(*pair) for pair in [(start, upright), *ends]):
            return [upright, *chain.from_iterable([*pair * times, upright] for pair in ends)]
    return []


@dataclass(frozen=True, slots=True, eq=False)
class _FreeSpace:
    """Postures to which an arm may move.

    Attributes:
        context: The arm.
        dynamics: The dynamics of its chain.
        clearance_m: The clearance that the body must keep, which is small because neighbouring
            links may always be near each other.
        limits: The kinematic limits of all joints.
        max_torque: Gravity torque (dof,) that the servo of each joint can hold without being judged
            as blocked.
    """

    context: ArmContext
    dynamics: Dynamics
    clearance_m: float
    limits: Sequence[KinematicLimits]
    max_torque: Vector

    @classmethod
    def of(cls, context: ArmContext, dynamics: Dynamics, start: Vector) -> _FreeSpace:
        clearance_m = min(_CLEARANCE_M, 0.7 * context.clearance_m(start))
        most = [_max_gravity(context, column) for column in context.index.chain]
        limits = context.planner.motion_limits(_SPEED_CLASS)
        return cls(context, dynamics, clearance_m, limits, np.array(most))

    def reachable_postures(self, at: Vector, random: np.random.Generator) -> Iterator[Vector]:
        """Yield postures (n,) with a free path from ``at``."""
        (lower, upper), near = self._inner_limits(), self.context.index.chain_joints(at)
        lower = np.minimum(np.maximum(lower, near - _MAX_WAY), near)
        upper = np.maximum(np.minimum(upper, near + _MAX_WAY), near)
        for _ in range(_MAX_DRAWS):
            q = random.uniform(lower, upper)
            posture = self.context.index.with_chain(at, q)
            has_room = self.context.clearance_m(posture) > self.clearance_m
            if has_room and self.is_way_free(at, posture):
                yield posture

    def upright_postures(self, at: Vector, random: np.random.Generator) -> Iterator[Vector]:
        """Yield postures (n,) in which links load the joints little, the best first."""
        (lower, upper), near = self._inner_limits(), self.context.index.chain_joints(at)
        pool = random.uniform(lower, upper, (_UPRIGHT_DRAWS, len(near)))
        for spread in _UPRIGHT_SPREADS:
            best = pool[np.argsort(self._loads(pool).sum(axis=1))[:_CANDIDATES]]
            around = best.repeat(_UPRIGHT_DRAWS // _CANDIDATES, axis=0)
            drawn = np.clip(random.normal(around, spread * (upper - lower)), lower, upper)
            pool = np.vstack([pool, drawn])
        loads = self._loads(pool)
        # Joints that gravity never loads keep their position.
        pool = np.where(loads.max(axis=0) > _UNLOADED_SHARE * loads.max(), pool, near)
        order = np.argsort(loads.sum(axis=1))
        for k in range(int(np.log2(len(order)))):
            yield self.context.index.with_chain(at, pool[order[2**k - 1]])

    def _loads(self, q: Matrix) -> Matrix:
        """Compute the sum of the absolute gravity torques of all links on each joint (k, dof)."""
        return np.abs(gravity_columns(self.dynamics, q)).sum(axis=2)

    def _inner_limits(self) -> tuple[Vector, Vector]:
        lower, upper = self.context.chain.lower_rad, self.context.chain.upper_rad
        lower, upper = np.maximum(lower, -np.pi), np.minimum(upper, np.pi)
        margin = _LIMIT_MARGIN * (upper - lower)
        return lower + margin, upper - margin

    def is_way_free(self, start: Vector, goal: Vector) -> bool:
        """Check whether the arm may move from one posture (n,) to another and back."""
        path = self.context.interpolate_joints(start, goal)[::_PATH_STEP]
        torques = np.abs(self.dynamics.gravity_torques(self.context.index.chain_joints(path)))
        if (torques > self.max_torque).any():
            return False
        try:
            # Check a faster motion, back and forth, which sags a little more than the real one.
            for ends in ((start, goal), (goal, start)):
                self.context.check_streamed_path(JointMove(*ends, self.limits), _SPEED_CLASS)
        except RefusedError:
            return False
        return True


def _max_gravity(context: ArmContext, column: int) -> float:
    """Compute the nominal gravity torque up to which a joint may move; infinite if unknown.

    The servo can still lift links that are heavier by `_HEAVIER`, against the friction of its
    loaded gears, with a lead that the guard allows and that its motor can sustain.
    """
    driven, model = context.servos.driven_joints[column], context.model
    drive = joint_drive(model.joint(driven.joint), model.supply_v)
    if drive is None:
        return np.inf
    speed = context.planner.motion_limits("slow")[column].speed_rad_s
    usual = context.planner.motion_limits(_SPEED_CLASS)[column].speed_rad_s
    lead = _LEAD_SHARE * driven.max_lead_ticks(usual) * driven.joint_map.unit_per_tick
    pressed = drive.stiffness_nm_rad * min(lead, sustained_lag(drive)) - drive.damping_nm_s * speed
    low, high = 0.0, max(pressed, 0.0)
    for _ in range(_HALVINGS):
        held = (low + high) / 2.0
        lifts = drive.friction.static_load_nm(2.0 * held) - held < pressed
        low, high = (held, high) if lifts else (low, held)
    return low / _HEAVIER


def _determinant(information: Matrix) -> float:
    scale = np.abs(information).max(initial=1e-12)
    return float(np.linalg.slogdet(information + _PRIOR * scale * np.eye(len(information)))[1])


def record_excitation(
    context: ArmContext,
    runner: MotionRunner,
    excitation: Excitation,
    on_cycle: Callable[[ControlCycle], None] | None = None,
) -> DriveRecording:
    """Run the tour and return the recording of the servos.

    While a joint moves alone, only its servos are read, after each goal, because gears cross their
    backlash within a few hundredths of a second. The other values stay unchanged.

    Raises:
        IkservoError: The errors of every motion; see ``Arm``.
    """
    excitation = excitation.starting_at(context.servos.reference())
    context.check_streamed_path(excitation, "slow")
    names, columns = context.chain.names, list(context.index.chain)
    all_joints = context.servos.drive_reader(names)
    single = [context.servos.drive_reader([name]) for name in names]
    cycle_s = runner.loop.cycle_time_s
    period_s = max(_READ_PERIOD_S, _READ_CYCLES * cycle_s)
    # Goals come once per cycle, and the duty follows each step. Its dependence on the time since
    # the goal is fitted to readings at evenly spread times; see `DriveRecording`.
    phases_s = (_PHASE_SHARE * cycle_s * (_GOLDEN * k % 1.0) for k in count())
    goals_s: list[float] = []
    times: list[tuple[float, float, float]] = []
    replies: list[tuple[float, float]] = []
    goals: list[Vector] = []
    drives: list[Matrix] = []

    def read(moving: NDArray[np.intp]) -> Matrix | None:
        if not drives or len(moving) != 1:
            return all_joints.read()
        joint = columns.index(moving[0])
        own = single[joint].read()
        if own is None:
            return None
        row = drives[-1].copy()
        row[joint, : own.shape[1]] = own[0]
        return row

    def record(cycle: ControlCycle) -> None:
        now_s = context.now_s()
        goals_s.append(now_s)
        moving = excitation.moving(cycle.time_s)
        if not times or len(moving) == 1 or now_s - times[-1][0] >= period_s:
            context.servos.clock.sleep_until(now_s + next(phases_s))
            asked_s = context.now_s()
            measured = read(moving)
            if measured is not None:
                replies.append((asked_s - now_s, context.now_s() - now_s))
                times.append((now_s, cycle.time_s, asked_s))
                goals.append(cycle.goals)
                drives.append(measured)
        if on_cycle:
            on_cycle(cycle)

    profile_rad_s = context.model.speed(_PROFILE_CLASS).rad_s
    runner.run(lambda _: excitation, record, _SPEED_CLASS, profile_rad_s=profile_rad_s)
    recording = _make_recording(
        context, excitation, np.array(times), np.array(goals), np.array(drives)
    )
    ages_s = (
        _sample_ages(np.array(replies), drives[0]) - context.servos.goals_wire_s - _SERVO_LOOP_S
    )
    # A servo's profile moves to each goal at its speed limit and arrives after a part of a cycle.
    profile_speeds = context.servos.profile_speeds(profile_rad_s)[list(context.index.chain)]
    profile_share = np.minimum(np.abs(recording.speed) / profile_speeds, 1.0)
    held_s = np.diff(goals_s)
    mean_s = 0.5 * (held_s @ held_s) / held_s.sum() * (1.0 + profile_share)
    return replace(recording, goal_age_s=ages_s - mean_s)


def _sample_ages(replies: Matrix, drive: Matrix) -> Matrix:
    """Compute the time from goals to the sample of each joint's servos (m, joints), seconds.

    No manual says whether a servo samples when the instruction arrives or when its turn to reply
    comes. The middle is assumed, so the error is at most half of the time between the two.

    Args:
        replies: Start and end (m, 2) of each reading, after the goals.
        drive: One reading (joints, most, 4): servos reply one after the other.
    """
    counts = np.isfinite(drive[..., 0]).sum(axis=1)
    share = 0.5 * (np.cumsum(counts) - 0.5 * counts) / counts.sum()
    return replies[:, :1] + (replies[:, 1:] - replies[:, :1]) * share


def _make_recording(
    context: ArmContext, excitation: Excitation, times: Matrix, goals: Matrix, drives: Matrix
) -> DriveRecording:
    columns = list(context.index.chain)
    clock_s, motion_s, read_s = times.T
    # The motion's own time runs more slowly while a joint lags.
    rate = np.gradient(motion_s, clock_s)
    speeds = np.array([excitation.state(time_s).velocity for time_s in motion_s])
    return DriveRecording(
        time_s=read_s - read_s[0],
        leg=np.array([excitation.leg_at(float(at_s)) for at_s in motion_s]),
        speed=smooth_samples(speeds[:, columns] * rate[:, None]),
        goal=goals[:, columns],
        position=drives[:, :, 0, 3],
        duty=drives[..., 0],
        current_a=drives[..., 1],
        voltage_v=drives[..., 2],
        goal_age_s=np.zeros_like(goals[:, columns]),
    )
