"""Preparation of an automatic calibration: limited torque, postures, stored progress.

The limits are not known yet; the zeros are, for the arm was held in a named pose. So the guard is
given the arm file's ranges and a little more, the arm's slowest speed, and nothing else passes.

The travel of a joint between its stops is kept in ticks of the bare encoder: these stay the same
whatever is written into the servo, and wherever the arm is held when the next run begins.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import chain, islice

import numpy as np

from ikservo.arm.calibrated_arm import CalibratedArm, ZeroSource
from ikservo.arm.context import ArmContext
from ikservo.calibration import Limits
from ikservo.calibration.homing import TickRange
from ikservo.calibration.procedure import CalibrationState
from ikservo.calibration.range_tracker import JointUnderCalibration
from ikservo.calibration.records import (
    PartialCalibration,
    StoredJointMeasurement,
    dump_partial,
    read_partial,
)
from ikservo.calibration.result import CalibrationResult, RegisterValues, measure_joint
from ikservo.calibration.servo_config import ServoConfig, read_servo_config
from ikservo.calibration.transaction import commit, plan_changes
from ikservo.control.servo_group import ServoGroup
from ikservo.errors import BusError, CalibrationError, FileFormatError, RefusedError
from ikservo.files.writing import remove_durably, write_atomic
from ikservo.guard import CollisionChecker, CommandLimits, sample_line
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.maintenance.calibration_session import TorqueOffArm
from ikservo.model import Model, ModelJoint
from ikservo.model.collision_model import collision_body
from ikservo.registers import RegisterName

__all__ = [
    "SEARCH_MARGIN_RAD",
    "MeasuredRanges",
    "PosturePlanner",
    "can_probe",
    "configure_encoders",
    "limited_context",
    "restore_encoders",
    "with_known_ranges",
]


SEARCH_MARGIN_RAD = math.radians(20.0)
"""How far past its expected end a joint may look for its stop, the horn's angle."""

_WIDENING_RAD = 300 / 360  # of a turn: such a joint has no stops, or none that is worth looking for
_SPEED_MARGIN = 1.2


def can_probe(subject: JointUnderCalibration, wizard: CalibrationState) -> bool:
    """Return whether a joint has stops to be looked for."""
    roomy = (
        subject.ticks_per_turn > 0
        and subject.expected_ticks >= _WIDENING_RAD * subject.ticks_per_turn
    )
    left_out = subject.name in wizard.free | wizard.skipped
    return not (roomy or left_out or subject.known)


def configure_encoders(
    loose: TorqueOffArm, wizard: CalibrationState, pose: str
) -> CalibrationResult:
    """Let every servo count so that no seam lies where its stop is looked for; torque is off.

    The calibration file is left as it is; see ``restore_encoders``.

    Returns:
        The arm as it is known from its pose alone.

    Raises:
        CalibrationError: A joint would cross a seam that cannot be moved.
        IkservoError: A servo cannot be written; nothing is changed, or it says how to go on.
    """
    subjects = tuple(_widen_range(subject, wizard) for subject in wizard.subjects)
    names = frozenset(subject.name for subject in subjects)
    wide = replace(wizard, subjects=subjects, skipped=names, free=frozenset())
    found = loose.build_calibration(wide, pose, datetime.now(UTC))
    memory = {
        i: _registers_without_limits(loose.facts[i], dict(held)) for i, held in found.memory.items()
    }
    _write_registers(loose, memory)
    return found


@contextmanager
def restore_encoders(loose: TorqueOffArm, tell: Callable[[str], None]) -> Generator[None]:
    """Give limp servos back what they held, where the block ends without a calibration.

    An arm that holds is not dropped for that: then it is told how to get them back.

    Args:
        loose: The servos, as they were found.
        tell: Takes what was done or is to do, in words.
    """
    memory = {i: facts.registers for i, facts in loose.facts.items()}
    try:
        yield
    except BaseException:
        with contextlib.suppress(BusError):  # who is silent has been named already
            _restore_registers(loose, memory, tell)
        raise


def _restore_registers(
    loose: TorqueOffArm, memory: RegisterValues, tell: Callable[[str], None]
) -> None:
    if loose.journal_path.exists() or not plan_changes(loose.bus, memory):
        return
    if not loose.torque_on_servos():
        _write_registers(loose, memory)
        tell("The settings of the servos were restored.")
        return
    again = f"ikservo calibrate {loose.model.name}"
    old = f"; or restore the previous calibration: ikservo calibration push {loose.model.name}"
    filed = old if loose.path.exists() else ""
    tell(f"The servos keep the settings of the search. Calibrate again: {again}{filed}.")


def _write_registers(loose: TorqueOffArm, memory: RegisterValues) -> None:
    changes = plan_changes(loose.bus, memory)
    if changes:
        text = loose.path.read_text("utf-8") if loose.path.exists() else ""
        commit(loose.bus, loose.journal_path, loose.path, text, changes)
        loose.facts = {
            servo_id: read_servo_config(loose.bus, servo_id) for servo_id in loose.bus.servos
        }


def limited_context(
    loose: TorqueOffArm, wizard: CalibrationState, known: CalibrationResult, space: CollisionChecker
) -> ArmContext:
    """Return the arm with the limits of the search; no torque changes."""
    model, bus = loose.model, loose.bus
    own = CalibratedArm(bus, model, ZeroSource.CALIBRATED, known.calibration)
    subjects = {subject.name: subject for subject in wizard.subjects}
    fences = [
        _search_limits(own, joint, subjects[joint.name], wizard, loose) for joint in model.joints
    ]
    shadows = {joint.name: [servo.id for servo in joint.shadows] for joint in model.joints}
    servos = ServoGroup(bus, fences, shadows, bus.clock, model.health)
    zeros = ZeroSource.CALIBRATED
    return ArmContext.build(model, model.chain, servos, bus.port, space, zeros)


def _search_limits(
    own: CalibratedArm,
    joint: ModelJoint,
    subject: JointUnderCalibration,
    wizard: CalibrationState,
    loose: TorqueOffArm,
) -> CommandLimits:
    limits = _widen_range(subject, wizard).expected
    speed = loose.model.speed("slow").rad_s * joint.travel_per_turn / math.tau
    return CommandLimits(own.joint_map(joint), limits, speed * _SPEED_MARGIN)


def _widen_range(subject: JointUnderCalibration, wizard: CalibrationState) -> JointUnderCalibration:
    """Return a joint with the range in which its stops are looked for."""
    if not can_probe(subject, wizard):
        return subject
    beyond = SEARCH_MARGIN_RAD / subject.joint_map.horn_rad_per_tick  # ticks
    room = (
        (subject.ticks_per_turn - 64 - subject.expected_ticks) / 2
        if subject.ticks_per_turn
        else beyond
    )
    more = min(beyond, room) * subject.joint_map.unit_per_tick
    low, high = subject.expected.lower.value - more, subject.expected.upper.value + more
    unit = subject.expected.unit
    return replace(subject, expected=Limits.of(subject.name, low, high, "the search", unit))


def _registers_without_limits(facts: ServoConfig, held: Mapping[str, int]) -> dict[str, int]:
    """Return what a servo shall hold, its own limits opened: they may lie inside the stops."""
    low, high = (
        facts.table.find(RegisterName.MIN_POSITION_LIMIT),
        facts.table.find(RegisterName.MAX_POSITION_LIMIT),
    )
    return {**held, low.name: low.range[0], high.name: high.range[1]}


_SAMPLES = 30
_MAX_TRIES, _DETOURS = 400, 40
_LIMIT_MARGIN_RAD = 0.26  # from the arm file's ends: nobody knows yet where the true ones are
_INSIDE_MEASURED_RAD = 0.06  # from ends that have been measured
# So near its end a joint may meet its own neighbour: that is what many stops are. What it never
# may meet is the table, or a thing that stands there.
_NEARBY_RAD = 0.22
# Postures by chance seldom leave room for a long arm above its table; the best are improved.
_IMPROVED = 10
_WIDE_RAD, _FINE_RAD = 0.4, 0.03
_ENOUGH_M = 0.004


class PosturePlanner:
    """Finds postures of one arm that is described but not yet measured.

    Args:
        model: The arm.
    """

    def __init__(self, model: Model) -> None:
        body = collision_body(model)
        self._own = len(body.pairs)
        self.space = CollisionChecker(body, model.floor_m, model.keep_out)
        self._known = [model.chain_pose(name) for name in model.poses]
        low = np.maximum(model.chain.lower_rad, -np.pi) + _LIMIT_MARGIN_RAD
        high = np.minimum(model.chain.upper_rad, np.pi) - _LIMIT_MARGIN_RAD
        self._low, self._high = np.minimum(low, high), np.maximum(low, high)

    def learn(self, column: int, low: float, high: float) -> None:
        """Take the measured range of a joint: it may stand nearer to ends that are known."""
        low, high = low + _INSIDE_MEASURED_RAD, high - _INSIDE_MEASURED_RAD
        if low < high:
            self._low[column], self._high[column] = low, high

    def path_to_clear(self, column: int, start: float, end: float, here: Vector) -> list[Vector]:
        """Return the way to a posture from which a joint can go to its end.

        Args:
            column: The joint's place in the chain's vectors.
            start: From where it goes, rad or m.
            end: Where its stop is expected, and a little beyond.
            here: Where the arm is (dof,).

        Returns:
            Postures (dof,) one after the other, the last with the joint at its start.

        Raises:
            RefusedError: The arm would touch something in every posture that was tried; says
                what in the best of them.
        """
        drive = _Drive(column, start, end)
        nearest = (-np.inf, "")
        for posture in chain([here], self._known, self._improved(drive)):
            begin = drive.begun(posture)
            nearest = max(nearest, self._least(drive, begin))
            if self._can_reach_end(begin, drive):
                way = self.find_path(here, begin)
                if way is not None:
                    return way
        raise RefusedError(_blocked(*nearest))

    def find_path(self, here: Vector, goal: Vector) -> list[Vector] | None:
        """Return postures (dof,) by which the arm gets to a goal and touches nothing, or None."""
        if self._is_path_free(sample_line(here, goal)):
            return [goal]
        for between in self._via_postures():
            if self._is_path_free(sample_line(here, between)) and self._is_path_free(
                sample_line(between, goal)
            ):
                return [between, goal]
        return None

    def _via_postures(self) -> Iterable[Vector]:
        return chain(self._known, islice(self._random_postures(), _DETOURS))

    def _random_postures(self) -> Iterator[Vector]:
        chance = np.random.default_rng(1)  # the same arm is treated alike each time
        while True:
            yield chance.uniform(self._low, self._high)

    def _improved(self, drive: _Drive) -> Iterator[Vector]:
        """Yield the postures by chance that leave most room, each improved joint by joint."""
        found = [drive.begun(posture) for posture in islice(self._random_postures(), _MAX_TRIES)]
        found.sort(key=lambda begin: self._least(drive, begin)[0], reverse=True)
        for begin in found[:_IMPROVED]:
            yield self._climbed(begin, drive)

    def _climbed(self, begin: Vector, drive: _Drive) -> Vector:
        """Return a posture from which small changes of single joints leave no more room."""
        best, best_m, step = begin, self._least(drive, begin)[0], _WIDE_RAD
        while step >= _FINE_RAD and best_m < _ENOUGH_M:
            rows = self._beside(best, step, drive.column)
            gap_m, row = max((self._least(drive, row)[0], i) for i, row in enumerate(rows))
            if gap_m > best_m:
                best, best_m = rows[row], gap_m
            else:
                step /= 2
        return best

    def _beside(self, posture: Vector, step: float, column: int) -> Matrix:
        """Return the postures (n, dof) in which one other joint stands a step elsewhere."""
        steps = step * np.vstack([np.eye(len(posture)), -np.eye(len(posture))])
        steps[:, column] = 0.0
        rows = np.clip(posture + steps, self._low, self._high)
        rows[:, column] = posture[column]
        return rows

    def _least(self, drive: _Drive, begin: Vector) -> tuple[float, str]:
        """Return the least gap [m] on the way to an end, and between what it is."""
        gap_m = self._gaps(drive, begin).min(axis=0)
        pair = int(np.argmin(gap_m))
        return float(gap_m[pair]), " would touch ".join(self.space.pairs[pair])

    def _gaps(self, drive: _Drive, begin: Vector) -> Matrix:
        """Return the gaps (looks, pairs) [m] that count on the way of a joint to its end."""
        way = drive.swept(begin)
        gap_m = self.space.distances(way)
        gap_m[np.abs(way[:, drive.column] - drive.start) > drive.alone, : self._own] = np.inf
        return gap_m

    def _can_reach_end(self, begin: Vector, drive: _Drive) -> bool:
        around_m = self.space.distances(drive.swept(begin))[:, self._own :]
        if not (around_m >= 0.0).all():
            return False
        return self._is_path_free(drive.swept(begin, drive.alone))

    def _is_path_free(self, way: Sequence[Vector] | Matrix) -> bool:
        try:
            self.space.check_path(list(way))
        except RefusedError:
            return False
        return True


@dataclass(frozen=True, slots=True)
class _Drive:
    """One joint's way to its end, whatever the others do; rad or m.

    Attributes:
        column: The joint's place in the chain's vectors.
        start: From where it goes.
        end: Where to.
    """

    column: int
    start: float
    end: float

    @property
    def alone(self) -> float:
        """Return how far it goes before it may meet its neighbour."""
        return max(abs(self.end - self.start) - _NEARBY_RAD, 0.0)

    def begun(self, posture: Vector) -> Vector:
        """Return a posture with the joint at its start."""
        begin = posture.copy()
        begin[self.column] = self.start
        return begin

    def swept(self, begin: Vector, most: float = math.inf) -> Matrix:
        """Return the way (looks, dof), no further than so far from its start."""
        far = min(abs(self.end - self.start), most)
        rows: Matrix = np.tile(begin, (_SAMPLES, 1))
        rows[:, self.column] += np.linspace(
            0.0, math.copysign(far, self.end - self.start), _SAMPLES
        )
        return rows


def _blocked(gap_m: float, touch: str) -> str:
    if gap_m >= 0.0:
        return "no free path was found to a posture that leaves room for it"
    return f"{touch} by {-gap_m * 1e3:.0f} mm in the best posture found"


class MeasuredRanges:
    """The measured joints of one arm on one adapter.

    Args:
        loose: The arm.

    Attributes:
        path: The file.
        travels: The measured joints, as the file has them; none where there is no sound file.
        written: When the file was written; empty where there is none.
    """

    def __init__(self, loose: TorqueOffArm) -> None:
        self._loose, self.path = loose, loose.partial_path
        found = _read_matching(loose)
        self.written = found.written if found else ""
        rows = found.joints if found else ()
        self.travels = {
            j.name: TickRange(j.low_tick, j.high_tick) for j in rows if self._matches_arm(j)
        }

    def add_joint(self, subject: JointUnderCalibration, travel: TickRange) -> None:
        """Add a joint to the file.

        Raises:
            FileWriteError: The disk will not take it.
        """
        self.travels[subject.name] = travel
        write_atomic(self.path, dump_partial(self._make_partial()))

    def remove_file(self) -> None:
        """Remove the file: a calibration has been saved, or all is measured anew.

        Raises:
            FileWriteError: It stays.
        """
        self.travels.clear()
        remove_durably(self.path)

    def _matches_arm(self, joint: StoredJointMeasurement) -> bool:
        facts = self._loose.facts.get(joint.servo_id)
        ids = {j.name: j.servo.id for j in self._loose.model.joints}
        known = ids.get(joint.name) == joint.servo_id and joint.low_tick < joint.high_tick
        return known and facts is not None and facts.table.model_name == joint.servo_model

    def _make_partial(self) -> PartialCalibration:
        ids = {joint.name: joint.servo.id for joint in self._loose.model.joints}
        rows = [
            StoredJointMeasurement(
                name=name,
                servo_id=ids[name],
                servo_model=self._loose.facts[ids[name]].table.model_name,
                low_tick=travel.low,
                high_tick=travel.high,
            )
            for name, travel in self.travels.items()
        ]
        now = datetime.now(UTC).isoformat(timespec="seconds")
        arm = self._loose.model.name
        return PartialCalibration(format=1, arm=arm, written=now, joints=tuple(rows))


def with_known_ranges(
    wizard: CalibrationState, travels: Mapping[str, TickRange]
) -> CalibrationState:
    """Return a conversation, its anchor taken, in which measured joints are not swept again.

    A joint that now stands outside what was measured is measured anew.
    """
    subjects = (_with_known_range(wizard, s, travels.get(s.name)) for s in wizard.subjects)
    return replace(wizard, subjects=tuple(subjects))


def _with_known_range(
    wizard: CalibrationState, subject: JointUnderCalibration, travel: TickRange | None
) -> JointUnderCalibration:
    known = replace(subject, known=travel)
    try:
        measure_joint(wizard, known)
    except CalibrationError:
        return subject
    return known


def _read_matching(loose: TorqueOffArm) -> PartialCalibration | None:
    try:
        found = read_partial(loose.partial_path)
    except FileFormatError:  # no more than some minutes of work: measured anew
        return None
    return found if found and found.arm == loose.model.name else None
