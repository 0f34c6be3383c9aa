"""The result of a calibration: measured joints, the calibration to save, expected registers.

A joint's stops are near the limits of the arm file. If one end of the recorded range is far beyond
its limit and the other end is not, the zero is shifted: the arm was not in the pose. If the range
is as wide as in the arm file, a much smaller shift can be detected.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from datetime import datetime

from ikservo.apps.calibrating.by_hand_procedure import CalibrationState, is_full_turn
from ikservo.calibration.homing import MAX_X_OFFSET, Homing, TickRange, choose_homing
from ikservo.calibration.joint_limits import Limits
from ikservo.calibration.joint_map import JointMap, encoder_of, unwrap_near, wrapped_difference
from ikservo.calibration.records import CalibratedJoint, CalibratedServo, Calibration, RangeSource
from ikservo.calibration.servo_config import ServoConfig, expected_registers, is_multi_turn
from ikservo.calibration.uncalibrated_joint import JointUnderCalibration
from ikservo.errors import CalibrationError
from ikservo.registers import Family

# The largest shift of the zero that is accepted without a question, by unit: for a range that
# differs from the arm file's, and for a range that is as wide. Less than 5° would question good
# calibrations: a pose that is set by eye and the stops of printed parts differ by some degrees.
_MAX_SHIFT = {"rad": math.radians(10.0), "m": 0.004}
_MAX_SHIFT_OF_SAME_WIDTH = {"rad": math.radians(5.0), "m": 0.002}
_SAME_WIDTH = {"rad": math.radians(1.0), "m": 0.0005}


@dataclass(frozen=True, slots=True)
class MeasuredJoint:
    """The measured sign, zero and travel of a joint.

    Attributes:
        joint_map: The sign and zero of the joint, in encoder ticks; in reported ticks after
            ``shift_ticks``.
        travel: The range of the joint, in the same ticks.
        swept: The source of the range.
    """

    joint_map: JointMap
    travel: TickRange
    swept: RangeSource

    def shift_ticks(self, shift: int) -> MeasuredJoint:
        """Return this joint with its ticks counted from ``shift``."""
        moved = self.joint_map.with_mounting(self.joint_map.sign, self.joint_map.zero_tick - shift)
        travel = TickRange(self.travel.low - shift, self.travel.high - shift)
        return MeasuredJoint(moved, travel, self.swept)

    def range_inside_margin(self, margin_rad: float) -> tuple[float, float] | None:
        """Return the range, less a margin at both ends; None if the range was not recorded."""
        if self.swept == "not swept":
            return None
        margin = margin_rad / self.joint_map.horn_rad_per_tick
        inside = (self.travel.low + margin, self.travel.high - margin)
        low, high = sorted(self.joint_map.position(tick) for tick in inside)
        return low, high

    def limits(self, expected: Limits, margin_rad: float, user: Limits | None) -> Limits:
        """Return the intersection of the recorded range, the arm file and the user's limits.

        Raises:
            CalibrationError: The intersection is empty; the message names two disjoint ranges.
        """
        ends = self.range_inside_margin(margin_rad)
        if ends:
            swept = Limits.of(expected.joint, *ends, "hand sweep", expected.unit)
            expected = expected.intersect(swept)
        return expected.intersect(user) if user else expected


def measure_joint(state: CalibrationState, subject: JointUnderCalibration) -> MeasuredJoint:
    """Return the sign, zero and travel of a joint, in encoder ticks (without homing offset).

    Raises:
        CalibrationError: A range that was known before does not contain the reference pose.
    """
    track, anchor = state.tracks[subject.servo_id], state.reference_ticks[subject.servo_id]
    placed, name = subject.with_mounting(state.sign(subject), anchor), subject.name
    if subject.known:
        earlier: RangeSource = "by itself" if state.motor_driven else "by LeRobot"
        return MeasuredJoint(placed, _travel_around(subject, subject.known, anchor), earlier)
    if name in state.skipped or name in state.free or is_full_turn(state, subject):
        expected = subject.expected
        ends = placed.ticks_inside(expected.lower.value, expected.upper.value)
        return MeasuredJoint(placed, TickRange(*ends), "not swept")
    source: RangeSource = "by itself" if state.motor_driven else "by hand"
    return MeasuredJoint(placed, TickRange(track.low, track.high), source)


def _travel_around(subject: JointUnderCalibration, known: TickRange, anchor: float) -> TickRange:
    """Return a travel, shifted by full revolutions so that it contains the reference tick."""
    shift = 0
    if subject.ticks_per_turn:
        middle = (known.low + known.high) // 2
        shift = unwrap_near(round(anchor), middle, subject.ticks_per_turn) - middle
    if not known.low + shift - 1 <= anchor <= known.high + shift + 1:
        raise CalibrationError(
            f"{subject.name}: its present position is outside the imported range.",
            "Check that the arm is in the pose and that the file belongs to this arm. Or: "
            "ikservo calibrate",
        )
    return TickRange(known.low + shift, known.high + shift)


_SAME_TICKS = 3  # smaller differences between servos of one joint are within their backlash

ServoConfigs = Mapping[int, ServoConfig]
RegisterValues = Mapping[int, Mapping[str, int]]
"""Raw register values by servo id and register name."""


@dataclass(frozen=True, slots=True)
class CalibrationMetadata:
    """The data of a calibration file other than its joints."""

    arm: str
    written: datetime
    tool_version: str
    usb_serial_number: str
    family: Family
    anchor_pose: str


@dataclass(frozen=True, slots=True)
class CalibrationResult:
    """A calibration, and the expected registers of each servo."""

    calibration: Calibration
    memory: RegisterValues


def build_calibration(
    state: CalibrationState,
    configs: ServoConfigs,
    metadata: CalibrationMetadata,
    *,
    write_limits: bool = False,
    user: Mapping[str, Limits] | None = None,
) -> CalibrationResult:
    """Compute the calibration from a procedure that has reached its review.

    ``configs`` are the servos' present settings by id; ``user`` are the limits that the user set.

    Raises:
        CalibrationError: A joint travels a revolution or more, or its range is empty.
    """
    memory: dict[int, Mapping[str, int]] = {}
    joints: list[CalibratedJoint] = []
    for subject in state.subjects:
        own = (user or {}).get(subject.name)
        homing, found = _apply_homing(state, subject, configs)
        limits = found.limits(subject.expected, state.margin_rad, own)
        inside = found.joint_map.ticks_inside(limits.lower.value, limits.upper.value)
        registers = inside if write_limits and not homing.extended else None
        for servo_id, offset in _choose_offsets(state, subject, configs, homing, found.travel):
            memory[servo_id] = expected_registers(
                configs[servo_id], offset, registers, extended=homing.extended
            )
        joints.append(_calibrated_joint(state, subject, found, own, configs, memory))
    margin_deg = math.degrees(state.margin_rad)
    calibration = Calibration(
        format=1, **asdict(metadata), margin_deg=margin_deg, joints=tuple(joints)
    )
    return CalibrationResult(calibration, memory)


def _apply_homing(
    state: CalibrationState, subject: JointUnderCalibration, configs: ServoConfigs
) -> tuple[Homing, MeasuredJoint]:
    """Choose the homing of the joint's servo; return it with the joint in ticks after homing."""
    lead, found = configs[subject.servo_id], measure_joint(state, subject)
    homing = choose_homing(
        subject.name,
        lead.table.family,
        found.travel,
        lead.offset,
        encoder_of(lead.table),
        counts_on=lead.is_multi_turn and not subject.shadow_ids,
    )
    if homing.extended and subject.shadow_ids:
        raise CalibrationError(
            f"{subject.name}: its travel crosses the encoder wrap-around of servo "
            f"{subject.servo_id}; two servos on one joint cannot both use multi-turn mode.",
            "Remount its horns so that the middle of the joint is near tick 2048.",
        )
    return homing, found.shift_ticks(homing.shift)


def _choose_offsets(
    state: CalibrationState,
    subject: JointUnderCalibration,
    configs: ServoConfigs,
    homing: Homing,
    travel: TickRange,
) -> list[tuple[int, int]]:
    """Choose the offsets that make a joint's other servos report the ticks of its first servo."""
    rows = [(subject.servo_id, homing.offset)]
    reported = round(state.reference_ticks[subject.servo_id] - homing.shift)
    for shadow_id in subject.shadow_ids:
        expected = wrapped_difference(
            round(state.reference_ticks[shadow_id]), reported, subject.ticks_per_turn
        )
        present = configs[shadow_id].offset
        offset = present if abs(expected - present) <= _SAME_TICKS else expected
        if (
            abs(offset) > MAX_X_OFFSET
            or travel.low < offset
            or travel.high - offset >= subject.ticks_per_turn
        ):
            raise CalibrationError(
                f"Servo {shadow_id} of {subject.name} is {offset} ticks away from servo "
                f"{subject.servo_id}; a homing offset corrects at most {MAX_X_OFFSET}.",
                f"Remount the horn of servo {shadow_id} so that both servos report nearly the "
                "same position.",
            )
        rows.append((shadow_id, offset))
    return rows


def _calibrated_joint(
    state: CalibrationState,
    subject: JointUnderCalibration,
    found: MeasuredJoint,
    user: Limits | None,
    configs: ServoConfigs,
    memory: RegisterValues,
) -> CalibratedJoint:
    lead, *shadows = (
        CalibratedServo(
            id=servo_id,
            model=configs[servo_id].table.model_name,
            firmware=configs[servo_id].firmware,
            holds=dict(memory[servo_id]),
        )
        for servo_id in (subject.servo_id, *subject.shadow_ids)
    )
    placed = found.joint_map
    return CalibratedJoint(
        name=subject.name,
        sign=1 if placed.sign == 1 else -1,
        sign_from="by hand" if subject.name in state.signs else "arm file",
        zero_tick=placed.zero_tick,
        gear=placed.gear,
        extended=is_multi_turn(lead.holds),
        swept=found.swept,
        travel_ticks=(found.travel.low, found.travel.high),
        servo=lead,
        shadows=tuple(shadows),
        **_in_file_units("", found.range_inside_margin(state.margin_rad), placed),
        **_in_file_units("user_", user and (user.lower.value, user.upper.value), placed),
    )


def _in_file_units(
    prefix: str, ends: tuple[float, float] | None, placed: JointMap
) -> dict[str, float]:
    if ends is None:
        return {}
    if placed.unit == "m":
        return {f"{prefix}lower_m": ends[0], f"{prefix}upper_m": ends[1]}
    low_deg, high_deg = map(math.degrees, ends)
    return {f"{prefix}lower_deg": low_deg, f"{prefix}upper_deg": high_deg}


@dataclass(frozen=True, slots=True)
class ShiftedZero:
    """A joint whose zero seems to be shifted.

    Attributes:
        subject: The joint.
        ends: The recorded range of the joint, rad or m.
        shift: The shift of the range that fits the arm file best, rad or m.
    """

    subject: JointUnderCalibration
    ends: tuple[float, float]
    shift: float

    def __str__(self) -> str:
        format_position, expected = self.subject.joint_map.format, self.subject.expected
        return (
            f"{self.subject.name} was swept from {' to '.join(map(format_position, self.ends))}, "
            f"not {format_position(expected.lower.value)} to "
            f"{format_position(expected.upper.value)} as in the arm file; the zero seems to be "
            f"off by {format_position(abs(self.shift))}."
        )


def find_shifted_zeros(
    state: CalibrationState, *, may_have_sagged: bool = False
) -> Iterator[ShiftedZero]:
    """Yield the measured joints whose zero is implausible, once the sweep has ended.

    Args:
        state: The calibration at its review.
        may_have_sagged: Whether nobody held the arm in its pose until the end. Both ends may then
            be off by the same angle; a user who moves the joints to their ends would notice that.

    Raises:
        CalibrationError: A range that was known before does not contain the reference pose.
    """
    for subject in state.subjects:
        ends = measure_joint(state, subject).range_inside_margin(0.0)
        if ends is None:
            continue
        above = ends[1] - subject.expected.upper.value
        below = subject.expected.lower.value - ends[0]
        shift, unit = (above - below) / 2, subject.joint_map.unit
        is_same_width = may_have_sagged and abs(above + below) <= _SAME_WIDTH[unit]
        if min(max(above, below), abs(shift)) > _MAX_SHIFT[unit] or (
            is_same_width and abs(shift) > _MAX_SHIFT_OF_SAME_WIDTH[unit]
        ):
            yield ShiftedZero(subject, ends, -shift)
