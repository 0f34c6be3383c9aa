"""Automatic calibration: drive joints gently to their end stops and measure the ranges."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from ikservo.arm.arm import Arm
from ikservo.arm.context import ArmContext
from ikservo.arm.motion_runner import MotionRunner
from ikservo.calibration import Limit, Limits
from ikservo.calibration.homing import TickRange
from ikservo.calibration.procedure import CalibrationState
from ikservo.calibration.range_tracker import ContactState, EndStopDetector, JointUnderCalibration
from ikservo.calibration.result import measure_joint
from ikservo.control.feedback import load_percent
from ikservo.control.loop import ControlCycle
from ikservo.errors import CalibrationError, RefusedError
from ikservo.hardware.bus import ServoBus
from ikservo.kinematics.arrays import Vector
from ikservo.maintenance.auto_calibration_setup import (
    SEARCH_MARGIN_RAD,
    PosturePlanner,
    can_probe,
    configure_encoders,
    limited_context,
)
from ikservo.maintenance.calibration_session import TorqueOffArm
from ikservo.model import Model
from ikservo.motion import KinematicLimits, OnlineTrajectory
from ikservo.registers import RegisterName

__all__ = [
    "AutoCalibration",
    "ContactResult",
    "RangeEnd",
    "check_auto_allowed",
    "early_contact_error",
    "horn_to_joint",
    "is_end_stop",
    "missing_stop_error",
    "nearly_a_turn",
    "probe_end_stop",
    "range_ends",
    "unreached",
]


_SPEED_FRACTION = 0.45  # than slow
_BACK_OFF_RAD = math.radians(4.0)  # the horn's angle
_ARRIVED_RAD = math.radians(1.5)
_POLL_PERIOD_S = 0.05


@dataclass(frozen=True, slots=True)
class ContactResult:
    """What one joint met.

    Attributes:
        position: How far it went, rad or m.
        contact: Whether that was a stop; `Touch.MOVING` where it went as far as it was sent.
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
    """Drive a joint towards a position until it stands against something, then back off.

    Args:
        context: The arm with the limits of the search, torque on.
        runner: Runs the motion.
        bus: Its servos.
        joint: Which.
        end: Its goal, rad or m: past the stop that is searched.
        fraction: Of its torque that the servo may use, 0 to 1; all of it again afterwards.
        on_positions: Called with the measured joints (n,) in every control cycle.

    Raises:
        StoppedError: The person interrupted; the arm holds.
        RefusedError: The guard stopped it; the arm holds.
    """
    search = _EndStopSearch(context, bus, joint, end, fraction, on_positions)
    try:
        runner.run(search.start_trajectory, search.on_cycle, "slow")
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
        joint_map = context.servos.fences[self._column].joint_map
        self._servo = bus.servos[joint_map.servo_id]
        self._per_horn = joint_map.unit_per_horn_rad
        self._trajectory: OnlineTrajectory | None = None
        self._polled_s = -math.inf
        self._leaving = False
        self.detector = EndStopDetector(max_load_percent=100.0 * fraction)
        self.furthest = math.nan

    def start_trajectory(self, start: Vector) -> OnlineTrajectory:
        self._context.servos.limit_force(self._joint, self._fraction)  # after torque-on
        lower, upper = self._context.limits()
        self._trajectory = OnlineTrajectory(start, self._slow_limits(), lower=lower, upper=upper)
        self._trajectory.retarget(self._with_position(start, self._end), 0.0)
        return self._trajectory

    def _slow_limits(self) -> list[KinematicLimits]:
        """Return limits that are slow and yet stop soon: the goal must not run past the stop."""
        planner = self._context.planner
        pairs = zip(planner.motion_limits("slow"), planner.motion_limits("normal"), strict=True)
        return [
            replace(soon, speed_rad_s=_SPEED_FRACTION * slow.speed_rad_s) for slow, soon in pairs
        ]

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
            self._back_off(trajectory, cycle, at)

    def _update_detector(self, at: float, goal: float) -> None:
        """Update the detector; the servo's load is read only where it decides."""
        now_s, horn, ahead = self._context.now_s(), at / self._per_horn, goal / self._per_horn
        if not self.detector.may_be_blocked(now_s, horn, ahead):
            self.detector = self.detector.update(now_s, horn)
        elif now_s - self._polled_s >= _POLL_PERIOD_S:
            self._polled_s = now_s
            load = load_percent(
                self._servo, self._bus.read(self._servo.id, RegisterName.PRESENT_LOAD)
            )
            self.detector = self.detector.update_with_load(now_s, horn, ahead, load)

    def _back_off(self, trajectory: OnlineTrajectory, cycle: ControlCycle, at: float) -> None:
        self.furthest, self._leaving = at, True
        back = math.copysign(_BACK_OFF_RAD * self._per_horn, self._end - at)
        if abs(self._end - at) < 2 * _ARRIVED_RAD * self._per_horn:
            back = 0.0
        trajectory.retarget(self._with_position(cycle.goals, at - back), cycle.time_s)

    def _with_position(self, joints: Vector, position: float) -> Vector:
        return self._context.index.with_position(joints, self._joint, position)


_EARLY_RAD = math.radians(15.0)  # no stop is further than that from where the arm file has it


@dataclass(frozen=True, slots=True)
class RangeEnd:
    """One end of a joint's range, rad or m.

    Attributes:
        joint: Whose.
        start: From where it is driven: the middle of its range.
        expected: Where the arm file has it.
        past: Where the joint is sent.
    """

    joint: str
    start: float
    expected: float
    past: float


def range_ends(subject: JointUnderCalibration) -> Iterator[RangeEnd]:
    """Yield the lower and the upper end of a joint's range."""
    low, high = subject.expected.lower.value, subject.expected.upper.value
    beyond, middle = SEARCH_MARGIN_RAD * horn_to_joint(subject), (low + high) / 2
    yield RangeEnd(subject.name, middle, low, low - beyond)
    yield RangeEnd(subject.name, middle, high, high + beyond)


def horn_to_joint(subject: JointUnderCalibration) -> float:
    """Return what one radian of the horn is worth at most, rad or m."""
    return subject.joint_map.unit_per_horn_rad


def is_end_stop(felt: ContactResult, end: RangeEnd, subject: JointUnderCalibration) -> bool:
    """Return whether a joint stands against its stop, not against something on the way."""
    short = (end.expected - felt.position) * math.copysign(1.0, end.past - end.start)
    return felt.contact is ContactState.STOP and short <= _EARLY_RAD * horn_to_joint(subject)


def early_contact_error(
    felt: ContactResult, end: RangeEnd, subject: JointUnderCalibration
) -> CalibrationError:
    """Return what to say of a joint that stands where its stop cannot be."""
    say = subject.joint_map.format
    if felt.contact is ContactState.NO_CONTACT:
        return CalibrationError(
            f"{end.joint} does not move from {say(felt.position)} although no load was felt.",
            "Nothing was saved. Check supply, cable and alarms: ikservo where. Or leave it to the "
            f"arm file: --skip {end.joint}",
        )
    return CalibrationError(
        f"{end.joint} hit something at {say(felt.position)}; its end stop is expected at "
        f"{say(end.expected)}.",
        "Nothing was saved; torque stays on. Remove the obstacle. If that is its end stop, "
        f"calibrate by hand: ikservo calibrate. Or leave it to the arm file: --skip {end.joint}",
    )


def missing_stop_error(
    felt: ContactResult, end: RangeEnd, subject: JointUnderCalibration
) -> CalibrationError:
    """Return what to say of a joint that went past where its stop is expected."""
    return CalibrationError(
        f"{end.joint} found no end stop up to {subject.joint_map.format(felt.position)}.",
        "Nothing was saved. Check that the arm was in the pose when it was recorded. If the "
        f"joint has no end stop: --continuous {end.joint}",
    )


def unreached(subject: JointUnderCalibration, lower: float | str, upper: float | str) -> str:
    """Return what to say of a joint of which an end cannot be looked for.

    Args:
        subject: The joint.
        lower: Where its lower stop was found, rad or m, or why it was not looked for.
        upper: Likewise.
    """
    say, expected = subject.joint_map.format, subject.expected
    ends = ((lower, expected.lower.value), (upper, expected.upper.value))
    reasons = [f"its end stop near {say(at)} ({why})" for why, at in ends if isinstance(why, str)]
    found = [f"the other is at {say(at)}" for at, _ in ends if isinstance(at, float)]
    kept = "the limit of the arm file is" if found else "both limits of the arm file are"
    missing = f"cannot search {', nor '.join(reasons)}; {kept} used there"
    return "; ".join([missing, *found]) + "."


def nearly_a_turn(subject: JointUnderCalibration) -> str:
    """Return what to say of a joint whose range leaves no room to look for stops."""
    say, expected = subject.joint_map.format, subject.expected
    low, high = expected.lower.value, expected.upper.value
    return (
        f"not searched: its range in the arm file, {say(low)} to {say(high)}, is nearly a whole "
        "turn or more; that range is used."
    )


_TORQUE_FRACTIONS = (0.3, 0.45, 0.6)  # of a servo's torque, one after the other


def check_auto_allowed(model: Model) -> None:
    """Refuse arms that must not look for their stops by themselves.

    Raises:
        CalibrationError: The arm file says so, and why.
    """
    if model.auto_unsafe:
        raise CalibrationError(
            f"{model.title} cannot search its end stops by itself: {model.auto_unsafe}",
            f"Calibrate it by hand: ikservo calibrate {model.name}",
        )


class AutoCalibration:
    """An arm that has been put into a named pose, and now finds its ranges itself.

    Args:
        loose: Its servos, torque off.
        wizard: The conversation, the anchor taken.
        pose: The named pose.
        tell: Takes what happens, in words.
        keep: Takes the travel of each joint whose two stops were found, in bare ticks.

    Attributes:
        wizard: The conversation with all that was found so far.
        arm: The arm behind its narrow fence.
        felt: The limit that is known of joints of which only one end could be looked for.
    """

    def __init__(
        self,
        loose: TorqueOffArm,
        wizard: CalibrationState,
        pose: str,
        tell: Callable[[str], None],
        keep: Callable[[JointUnderCalibration, TickRange], None],
    ) -> None:
        check_auto_allowed(loose.model)
        self._loose, self._tell, self._keep = loose, tell, keep
        self._postures = PosturePlanner(loose.model)
        known = configure_encoders(loose, wizard, pose)
        self._context = limited_context(loose, wizard, known, self._postures.space)
        self._runner = MotionRunner(self._context)
        self.arm = Arm(self._context, self._runner)
        self.arm.enable()
        tell("Torque is on. Let go of the arm and keep clear of it.")
        names = frozenset(subject.name for subject in wizard.subjects)
        self.wizard = replace(wizard, known_signs=names, motor_driven=True)
        self.partial_limits: dict[str, Limits] = {}

    def sweep(self) -> None:
        """Look for the stops of every joint that has some and was not measured before, tip first.

        Raises:
            CalibrationError: A joint met something where its stop cannot be, or no stop at all.
            StoppedError: The person interrupted; the arm holds.
            RefusedError: The guard stopped it; the arm holds.
        """
        for subject in reversed(self.wizard.subjects):
            if can_probe(subject, self.wizard):
                self._sweep_joint(subject)
            elif subject.known is not None:
                self._learn(subject)
            elif subject.name not in self.wizard.free | self.wizard.skipped:
                self.wizard = self.wizard.skip(subject.name, nearly_a_turn(subject))

    def finish(self) -> CalibrationState:
        """Lower the arm to its rest pose, let it go, and return the conversation at its review.

        Raises:
            CalibrationError: The servos of one joint did not go alike.
        """
        way = self._postures.find_path(self._chain_joints(), self.arm.model.chain_pose("rest"))
        for posture in way or []:
            self._move_to_posture(posture)
        self.arm.pose("rest", speed="slow")
        self._update_wizard(self._context.servos.measure_positions())
        self.arm.disable_torque()
        reading = self._loose.read_ticks()
        self.wizard = self.wizard.update(*reading) if reading else self.wizard
        return self.wizard.accept()

    def _sweep_joint(self, subject: JointUnderCalibration) -> None:
        lower, upper = (self._find_end_stop(end, subject) for end in range_ends(subject))
        if isinstance(lower, float) and isinstance(upper, float):
            track = self.wizard.tracks[subject.servo_id]
            self._keep(subject, TickRange(track.low, track.high))
            self._learn(subject)
            return
        reason = unreached(subject, lower, upper)
        self._tell(f"{subject.name}: {reason}")
        self.wizard = self.wizard.skip(subject.name, reason)
        self._record_end_stops(subject, lower, upper)

    def _learn(self, subject: JointUnderCalibration) -> None:
        """Let other joints be looked for with this one near the ends it is known to have."""
        names = self.arm.model.chain.names
        ends = measure_joint(self.wizard, subject).range_inside_margin(0.0)
        if ends is not None and subject.name in names:
            self._postures.learn(names.index(subject.name), *ends)

    def _record_end_stops(
        self, subject: JointUnderCalibration, lower: float | str, upper: float | str
    ) -> None:
        expected, margin = subject.expected, self.wizard.margin_rad * horn_to_joint(subject)
        low = expected.lower if isinstance(lower, str) else Limit(lower + margin, "felt")
        high = expected.upper if isinstance(upper, str) else Limit(upper - margin, "felt")
        self.partial_limits[subject.name] = Limits(subject.name, low, high, expected.unit)

    def _find_end_stop(self, end: RangeEnd, subject: JointUnderCalibration) -> float | str:
        """Return where a joint's stop is, rad or m, or why it cannot be looked for."""
        try:
            way = self._room(end)
        except RefusedError as error:
            return error.message
        for posture in way:
            self._move_to_posture(posture)
        self._tell(
            f"{end.joint}: searching its end stop near {subject.joint_map.format(end.expected)}."
        )
        felt = self._press_against(end, subject, _TORQUE_FRACTIONS[0])
        for share in _TORQUE_FRACTIONS[1:]:
            if is_end_stop(felt, end, subject):
                break
            felt = self._press_against(end, subject, share)
        if not is_end_stop(felt, end, subject):
            raise early_contact_error(felt, end, subject)
        return felt.position

    def _press_against(
        self, end: RangeEnd, subject: JointUnderCalibration, share: float
    ) -> ContactResult:
        """Drive a joint to its end with a share of its torque.

        Raises:
            CalibrationError: It got there, past where its stop is expected.
        """
        felt = probe_end_stop(
            self._context, self._runner, self._loose.bus, end.joint, end.past, share,
            self._update_wizard,
        )  # fmt: skip
        if felt.contact is ContactState.MOVING:
            raise missing_stop_error(felt, end, subject)
        return felt

    def _room(self, end: RangeEnd) -> list[Vector]:
        """Return the way to a posture in which the joint can go to its end.

        Raises:
            RefusedError: There is none; nothing has moved.
        """
        if end.joint not in self.arm.model.chain.names:
            return []
        column = self.arm.model.chain.names.index(end.joint)
        reach = end.expected + 0.25 * (end.past - end.expected)
        return self._postures.path_to_clear(column, end.start, reach, self._chain_joints())

    def _move_to_posture(self, posture: Vector) -> None:
        positions = dict(zip(self.arm.model.chain.names, posture.tolist(), strict=True))
        self.arm.move_joints(positions, speed="slow")

    def _chain_joints(self) -> Vector:
        return self._context.index.chain_joints(self._context.servos.goals())

    def _update_wizard(self, joints: Vector) -> None:
        """Let the conversation see where the servos are; shadows go with their first servo."""
        ticks, positions = dict[int, int](), self._context.index.by_name(joints)
        for subject in self.wizard.subjects:
            anchor = self.wizard.reference_ticks[subject.servo_id]
            position = positions[subject.name]
            placed = subject.with_mounting(self.wizard.sign(subject), anchor)
            tick = round(placed.exact_tick(position))
            ticks[subject.servo_id] = tick
            for shadow in subject.shadow_ids:
                ticks[shadow] = round(self.wizard.reference_ticks[shadow] + tick - anchor)
        self.wizard = self.wizard.update_unwrapped(self._loose.bus.clock.now_s(), ticks)
