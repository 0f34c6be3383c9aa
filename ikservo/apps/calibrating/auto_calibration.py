"""Automatic calibration: drive joints gently to their end stops and measure the ranges."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from ikservo.apps.calibrating.auto_calibration_setup import (
    SEARCH_MARGIN_RAD,
    MeasuredRanges,
    PosturePlanner,
    can_probe,
    configure_encoders,
    limited_context,
)
from ikservo.apps.calibrating.by_hand_procedure import CalibrationState
from ikservo.apps.calibrating.calibration_result import measure_joint
from ikservo.apps.calibrating.calibration_session import TorqueOffArm
from ikservo.apps.calibrating.range_tracker import ContactState, EndStopDetector
from ikservo.arm.arm import Arm
from ikservo.arm.motion_runner import MotionRunner
from ikservo.calibration import Limit, Limits
from ikservo.calibration.homing import TickRange
from ikservo.calibration.uncalibrated_joint import JointUnderCalibration
from ikservo.control.joint_reading import load_percent
from ikservo.control.loop import ControlCycle
from ikservo.control.stop_requests import REQUEST_HINT
from ikservo.errors import CalibrationError, RefusedError
from ikservo.hardware.bus import ServoBus
from ikservo.kinematics.arrays import Vector
from ikservo.maintenance.dialogue import Dialogue, Notice, Progress
from ikservo.maintenance.direction_check import show_directions
from ikservo.model import Model
from ikservo.motion import OnlineTrajectory
from ikservo.planning.context import ArmContext
from ikservo.registers import RegisterName

_SPEED_FRACTION = 0.45  # speed of the search, as a fraction of the speed "slow"
_BACK_OFF_RAD = math.radians(4.0)  # angle of the horn
_ARRIVED_RAD = math.radians(1.5)
_POLL_PERIOD_S = 0.05
# A joint presses with this fraction of its maximum lead. Beyond it, goals slow down; at 0.9 the
# joint counts as blocked. At this lead, every servo of the catalogue gives half of its torque.
_PRESSING_SHARE = 0.75


@dataclass(frozen=True, slots=True)
class ContactResult:
    """The result of moving a joint until something stops it.

    Attributes:
        position: The position at which the joint stopped, rad or m.
        contact: The reason why it stopped; ``ContactState.MOVING`` if it reached its goal.
    """

    position: float
    contact: ContactState


def probe_end_stop(
    context: ArmContext,
    runner: MotionRunner,
    bus: ServoBus,
    joint: str,
    end: float,
    fraction: float,
    on_positions: Callable[[Vector], None],
) -> ContactResult:
    """Move a joint towards a position until something stops it, then back off.

    Args:
        context: The arm with the limits of the search, torque on.
        runner: Runs the motion.
        bus: The servos of the arm.
        joint: The joint.
        end: The joint goal, rad or m, beyond the expected stop.
        fraction: The fraction of its torque that the servo may use, 0 to 1; full torque is restored
            afterwards.
        on_positions: Called with the measured joints (n,) in every control cycle.

    Raises:
        StoppedError: The user stopped the motion; the arm holds.
        RefusedError: The guard stopped the motion; the arm holds.
    """
    search = _EndStopSearch(context, bus, joint, end, fraction, on_positions)
    try:
        runner.run(search.start_trajectory, search.on_cycle, "slow", compensated=False)
    finally:
        context.servos.limit_force(joint, 1.0)
    return ContactResult(search.furthest, search.detector.contact)


class _EndStopSearch:
    def __init__(
        self,
        context: ArmContext,
        bus: ServoBus,
        joint: str,
        end: float,
        fraction: float,
        on_positions: Callable[[Vector], None],
    ) -> None:
        self._context, self._bus, self._joint, self._end = context, bus, joint, end
        self._fraction, self._on_positions = fraction, on_positions
        self._column = context.index.column(joint)
        driven = context.servos.driven_joints[self._column]
        joint_map = driven.joint_map
        self._servo = bus.servos[joint_map.servo_id]
        self._per_horn = joint_map.unit_per_horn_rad
        self._trajectory: OnlineTrajectory | None = None
        self._polled_s = -math.inf
        self._leaving = False
        # The lag behind the goal at which the servo presses with its full allowed torque.
        speed = context.planner.motion_limits("slow")[self._column].speed_rad_s
        lead_rad = driven.max_lead_ticks(speed) * joint_map.horn_rad_per_tick
        self.detector = EndStopDetector(100.0 * fraction, _PRESSING_SHARE * lead_rad)
        self.furthest = math.nan

    def start_trajectory(self, start: Vector) -> OnlineTrajectory:
        self._context.servos.limit_force(self._joint, self._fraction)  # after torque-on
        lower, upper = self._context.limits()
        # Slow limits with hard braking, so that the goal does not run past the stop.
        planner = self._context.planner
        pairs = zip(planner.motion_limits("slow"), planner.motion_limits("normal"), strict=True)
        limits = [
            replace(soon, speed_rad_s=_SPEED_FRACTION * slow.speed_rad_s) for slow, soon in pairs
        ]
        self._trajectory = OnlineTrajectory(start, limits, lower=lower, upper=upper)
        self._trajectory.retarget(self._with_position(start, self._end), 0.0)
        return self._trajectory

    def on_cycle(self, cycle: ControlCycle) -> None:
        self._on_positions(cycle.measured)
        trajectory, at = self._trajectory, float(cycle.measured[self._column])
        if trajectory is None or math.isfinite(trajectory.duration_s):
            return
        settled = cycle.time_s >= trajectory.settles_at_s
        if self._leaving:
            if settled:
                trajectory.stop(cycle.time_s)
            return
        self._update_detector(at, float(cycle.goals[self._column]))
        arrived = abs(at - self._end) <= _ARRIVED_RAD * self._per_horn
        if self.detector.contact is not ContactState.MOVING or (arrived and settled):
            self.furthest, self._leaving = at, True
            back = math.copysign(_BACK_OFF_RAD * self._per_horn, self._end - at)
            if abs(self._end - at) < 2 * _ARRIVED_RAD * self._per_horn:
                back = 0.0
            trajectory.retarget(self._with_position(cycle.goals, at - back), cycle.time_s)

    def _update_detector(self, at: float, goal: float) -> None:
        """Update the detector; read the servo's load only if the decision depends on it."""
        now_s, horn, ahead = self._context.now_s(), at / self._per_horn, goal / self._per_horn
        if not self.detector.may_be_blocked(now_s, horn, ahead):
            self.detector = self.detector.update(now_s, horn)
        elif now_s - self._polled_s >= _POLL_PERIOD_S:
            self._polled_s = now_s
            load = load_percent(
                self._servo, self._bus.read(self._servo.id, RegisterName.PRESENT_LOAD)
            )
            self.detector = self.detector.update_with_load(now_s, horn, ahead, load)

    def _with_position(self, joints: Vector, position: float) -> Vector:
        return self._context.index.with_position(joints, self._joint, position)


_EARLY_RAD = math.radians(15.0)  # largest distance of a stop from its position in the arm file


@dataclass(frozen=True, slots=True)
class RangeEnd:
    """One end of a joint's range, rad or m.

    Attributes:
        joint: The joint.
        start: The position from which the search starts: the middle of the joint's range.
        expected: The position of this end in the arm file.
        past: The goal of the search, beyond the expected position.
    """

    joint: str
    start: float
    expected: float
    past: float


def range_ends(subject: JointUnderCalibration) -> Iterator[RangeEnd]:
    """Yield the lower and the upper end of a joint's range."""
    low, high = subject.expected.lower.value, subject.expected.upper.value
    beyond, middle = SEARCH_MARGIN_RAD * subject.joint_map.unit_per_horn_rad, (low + high) / 2
    yield RangeEnd(subject.name, middle, low, low - beyond)
    yield RangeEnd(subject.name, middle, high, high + beyond)


def is_end_stop(found: ContactResult, end: RangeEnd, subject: JointUnderCalibration) -> bool:
    """Check whether a joint is at its stop and not at an obstacle before it."""
    missing = (end.expected - found.position) * math.copysign(1.0, end.past - end.start)
    early = _EARLY_RAD * subject.joint_map.unit_per_horn_rad
    return found.contact is ContactState.STOP and missing <= early


def early_contact_error(
    found: ContactResult, end: RangeEnd, subject: JointUnderCalibration
) -> CalibrationError:
    """Return the error for a joint that was stopped at a position without an end stop."""
    text = subject.joint_map.format
    if found.contact is ContactState.NO_CONTACT:
        return CalibrationError(
            f"{end.joint} does not move from {text(found.position)} although no load was felt.",
            "Nothing was saved. Check supply, cable and alarms: ikservo where. Or use the range "
            f"in the arm file: --skip {end.joint}",
        )
    return CalibrationError(
        f"{end.joint} hit something at {text(found.position)}; its end stop is expected at "
        f"{text(end.expected)}.",
        "Nothing was saved; torque stays on. Remove the obstacle. If this is the end stop, "
        "calibrate by hand: ikservo calibrate. Or use the range in the arm file: "
        f"--skip {end.joint}",
    )


def unreached(subject: JointUnderCalibration, lower: float | str, upper: float | str) -> str:
    """Describe a joint of which one or both ends could not be searched for.

    An end is the position of its stop, rad or m, or the reason why it was not searched for.
    """
    text, expected = subject.joint_map.format, subject.expected
    ends = ((lower, expected.lower.value), (upper, expected.upper.value))
    reasons = [
        f"for its end stop near {text(at)} ({why})" for why, at in ends if isinstance(why, str)
    ]
    found = [f"the other is at {text(at)}" for at, _ in ends if isinstance(at, float)]
    kept = "the limit of the arm file is" if found else "both limits of the arm file are"
    missing = f"cannot search {', nor '.join(reasons)}; {kept} used instead"
    return "; ".join([missing, *found]) + "."


def nearly_a_turn(subject: JointUnderCalibration) -> str:
    """Describe a joint whose range is too wide to search for its stops."""
    text, expected = subject.joint_map.format, subject.expected
    low, high = expected.lower.value, expected.upper.value
    return (
        f"not searched: its range in the arm file, {text(low)} to {text(high)}, is nearly a whole "
        "turn or more; that range is used."
    )


_TORQUE_FRACTIONS = (0.3, 0.45, 0.6)  # fractions of a servo's torque, tried in this order


def check_auto_allowed(model: Model) -> None:
    """Refuse an arm whose arm file forbids automatic calibration.

    Raises:
        CalibrationError: The arm file forbids it; the message gives the reason.
    """
    if model.auto_unsafe:
        text = f"{model.title} cannot search for its end stops by itself: {model.auto_unsafe}"
        raise CalibrationError(text, f"Calibrate it by hand: ikservo calibrate {model.name}")


class AutoCalibration:
    """Measurement of the ranges of an arm that is held in a named pose.

    Args:
        loose: The servos of the arm, torque off.
        state: The calibration state, with the reference pose recorded.
        pose: The named pose.
        measured: Stores the travel of each joint whose two stops were found.

    Attributes:
        state: The calibration state with all measurements so far.
        arm: The arm with the limits of the search.
        partial_limits: The limits of joints for which only one end could be searched.
    """

    def __init__(
        self, loose: TorqueOffArm, state: CalibrationState, pose: str, measured: MeasuredRanges
    ) -> None:
        check_auto_allowed(loose.model)
        self._loose, self._measured = loose, measured
        self._postures = PosturePlanner(loose.model)
        known = configure_encoders(loose, state, pose)
        self._context = limited_context(loose, state, known, self._postures.space)
        self._runner = MotionRunner(self._context)
        self.arm = Arm(self._context, self._runner)
        self.arm.listen()
        self._context.servos.stop_request.raise_if_set(REQUEST_HINT)
        self.arm.enable()
        names = frozenset(subject.name for subject in state.subjects)
        self.state = replace(state, known_signs=names, motor_driven=True)
        self.partial_limits: dict[str, Limits] = {}
        # The joint, the ends that were searched for, all ends to be searched, and when it began.
        self._number, self._done, self._ends, self._began_s = 1, 0, 0, 0.0

    def run(self) -> Dialogue[CalibrationState]:
        """Show each joint's direction, search for the stops, and return the state for review.

        Raises:
            CalibrationError: An unexpected joint moved, or a stop is in the wrong place.
            StoppedError: The user stopped the calibration; the arm holds.
            RefusedError: The guard stopped the calibration; the arm holds.
        """
        yield Progress("Each joint moves slightly")
        yield Notice("Torque is on. Let go of the arm and keep clear of it.")
        # This reveals a wrong sign or swapped ids before anything else moves.
        names = [joint.name for joint in self.arm.model.joints]
        yield from show_directions(self.arm, names, searching=True)
        yield from self.sweep()
        yield Progress("Moving to the rest pose")
        return self.finish()

    def sweep(self) -> Dialogue[None]:
        """Search for the end stops of each joint without a measured range, starting at the tip.

        Raises:
            CalibrationError: A joint was stopped in the wrong place, or no stop was found.
            StoppedError: The user stopped the search; the arm holds.
            RefusedError: The guard stopped the search; the arm holds.
        """
        self._began_s = self._loose.bus.clock.now_s()
        with self.arm.runner.requested():
            self._ends = 2 * sum(can_probe(each, self.state) for each in self.state.subjects)
            for number, subject in enumerate(reversed(self.state.subjects), 1):
                self._number = number
                if can_probe(subject, self.state):
                    yield from self._sweep_joint(subject)
                elif subject.known is not None:
                    self._learn(subject)
                elif subject.name not in self.state.free | self.state.skipped:
                    self.state = self.state.skip(subject.name, nearly_a_turn(subject))

    def finish(self) -> CalibrationState:
        """Lower the arm to its rest pose, switch torque off, and return the state for review.

        Raises:
            CalibrationError: The servos of one joint have moved by different angles.
        """
        path = self._postures.find_path(self._chain_joints(), self.arm.model.chain_pose("rest"))
        with self.arm.runner.requested():
            for posture in path or []:
                self._move_to_posture(posture)
            self.arm.pose("rest", speed="slow")
        self._update_state(self._context.servos.measure_positions())
        self.arm.disable_torque()
        reading = self._loose.read_ticks()
        self.state = self.state.update(*reading) if reading else self.state
        return self.state.accept()

    def _sweep_joint(self, subject: JointUnderCalibration) -> Dialogue[None]:
        lower_end, upper_end = range_ends(subject)
        lower = yield from self._find_end_stop(lower_end, subject)
        self._done += 1
        upper = yield from self._find_end_stop(upper_end, subject)
        self._done += 1
        if isinstance(lower, float) and isinstance(upper, float):
            track = self.state.tracks[subject.servo_id]
            self._measured.add_joint(subject, TickRange(track.low, track.high))
            self._learn(subject)
            return
        reason = unreached(subject, lower, upper)
        yield Notice(f"{subject.name}: {reason}")
        self.state = self.state.skip(subject.name, reason)
        expected = subject.expected
        margin = self.state.margin_rad * subject.joint_map.unit_per_horn_rad
        low = expected.lower if isinstance(lower, str) else Limit(lower + margin, "felt")
        high = expected.upper if isinstance(upper, str) else Limit(upper - margin, "felt")
        self.partial_limits[subject.name] = Limits(subject.name, low, high, expected.unit)

    def _learn(self, subject: JointUnderCalibration) -> None:
        """Pass the measured range of a joint to the posture planner."""
        names = self.arm.model.chain.names
        ends = measure_joint(self.state, subject).range_inside_margin(0.0)
        if ends is not None and subject.name in names:
            self._postures.learn(names.index(subject.name), *ends)

    def _find_end_stop(
        self, end: RangeEnd, subject: JointUnderCalibration
    ) -> Dialogue[float | str]:
        """Search for a joint's stop; return its position, rad or m, or why there was no search."""
        names, path = self.arm.model.chain.names, list[Vector]()
        try:
            if end.joint in names:  # to a posture in which the joint can move to its end
                column = names.index(end.joint)
                beyond = end.expected + 0.25 * (end.past - end.expected)
                present = self._chain_joints()
                path = self._postures.path_to_clear(column, end.start, beyond, present)
        except RefusedError as error:
            return error.message
        near = subject.joint_map.format(end.expected)
        what = f"{end.joint}: searching for its end stop near {near}"
        yield Notice(f"{what} (joint {self._number} of {len(self.state.subjects)}).")
        since_s = self._loose.bus.clock.now_s() - self._began_s
        yield Progress(what, self._done, self._ends, since_s)
        for posture in path:
            self._move_to_posture(posture)
        found = self._press_against(end, subject, _TORQUE_FRACTIONS[0])
        for fraction in _TORQUE_FRACTIONS[1:]:
            if is_end_stop(found, end, subject):
                break
            found = self._press_against(end, subject, fraction)
        if not is_end_stop(found, end, subject):
            raise early_contact_error(found, end, subject)
        return found.position

    def _press_against(
        self, end: RangeEnd, subject: JointUnderCalibration, fraction: float
    ) -> ContactResult:
        """Move a joint to its end with a fraction of its torque."""
        found = probe_end_stop(
            self._context, self._runner, self._loose.bus, end.joint, end.past, fraction,
            self._update_state,
        )  # fmt: skip
        if found.contact is ContactState.MOVING:
            raise CalibrationError(
                f"{end.joint} has no end stop up to {subject.joint_map.format(found.position)}.",
                "Nothing was saved. Check that the arm was in the pose when the pose was recorded. "
                f"If the joint has no end stop: --continuous {end.joint}",
            )
        return found

    def _move_to_posture(self, posture: Vector) -> None:
        positions = dict(zip(self.arm.model.chain.names, posture.tolist(), strict=True))
        self.arm.move_joints(positions, speed="slow")

    def _chain_joints(self) -> Vector:
        return self._context.index.chain_joints(self._context.servos.reference())

    def _update_state(self, joints: Vector) -> None:
        """Update the calibration state; other servos of a joint follow its first servo."""
        ticks, positions = dict[int, int](), self._context.index.by_name(joints)
        for subject in self.state.subjects:
            anchor = self.state.reference_ticks[subject.servo_id]
            position = positions[subject.name]
            placed = subject.with_mounting(self.state.sign(subject), anchor)
            tick = round(placed.exact_tick(position))
            ticks[subject.servo_id] = tick
            for shadow in subject.shadow_ids:
                ticks[shadow] = round(self.state.reference_ticks[shadow] + tick - anchor)
        self.state = self.state.update_unwrapped(self._loose.bus.clock.now_s(), ticks)
