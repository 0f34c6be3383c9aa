"""Preparation of an automatic calibration: limited torque, postures, stored progress.

The limits are not known yet, but the zeros are, because the arm was held in a named pose.
Therefore the guard uses the arm file's ranges with a margin, and the arm's slowest speed.

The travel of a joint between its stops is stored in raw encoder ticks. They do not depend on the
servo's registers, nor on the pose in which the next run starts.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import chain, islice

import numpy as np

from ikservo.apps.calibrating.by_hand_procedure import CalibrationState
from ikservo.apps.calibrating.calibration_result import CalibrationResult, measure_joint
from ikservo.apps.calibrating.calibration_session import TorqueOffArm
from ikservo.calibration import Limits
from ikservo.calibration.homing import TickRange
from ikservo.calibration.records import (
    PartialCalibration,
    StoredJointMeasurement,
    dump_partial,
    read_partial,
)
from ikservo.calibration.transaction import commit, plan_changes, read_journal, roll_back
from ikservo.calibration.uncalibrated_joint import JointUnderCalibration
from ikservo.control.servo_group import ServoGroup
from ikservo.errors import BusError, CalibrationError, FileFormatError, RefusedError
from ikservo.files.writing import remove_durably, write_atomic
from ikservo.guard import CollisionChecker, DrivenJoint, sample_line
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.model import Model
from ikservo.model.collision_capsules import collision_body
from ikservo.model.load_lag import LoadLag, load_lags
from ikservo.planning.calibrated_arm import CalibratedArm, ZeroSource
from ikservo.planning.context import ArmContext
from ikservo.registers import RegisterName

SEARCH_MARGIN_RAD = math.radians(20.0)
"""Largest angle of the horn by which a search goes beyond a joint's expected end."""

_MAX_SEARCHED_FRACTION = 300 / 360  # of a revolution; a joint with a wider range is not searched
_SPEED_MARGIN = 1.2


def can_probe(subject: JointUnderCalibration, state: CalibrationState) -> bool:
    """Check whether the end stops of a joint can be searched for."""
    too_wide = (
        subject.ticks_per_turn > 0
        and subject.expected_ticks >= _MAX_SEARCHED_FRACTION * subject.ticks_per_turn
    )
    excluded = subject.name in state.free | state.skipped
    return not (too_wide or excluded or subject.known)


def configure_encoders(
    loose: TorqueOffArm, state: CalibrationState, pose: str
) -> CalibrationResult:
    """Configure every servo (torque off) so that its count does not wrap during the search.

    The calibration file is not changed; see ``restore_encoders``. If the program is killed, the
    next one that opens the arm undoes the change from the journal.

    Returns:
        The calibration that follows from the pose alone.

    Raises:
        CalibrationError: A joint would cross a wrap-around that no setting can move.
        IkservoError: A servo cannot be written; nothing is changed, or the hint says what to do.
    """
    subjects = tuple(_widen_range(subject, state) for subject in state.subjects)
    names = frozenset(subject.name for subject in subjects)
    wide = replace(state, subjects=subjects, skipped=names, free=frozenset())
    found = loose.build_calibration(wide, pose, datetime.now(UTC))
    memory: dict[int, dict[str, int]] = {}
    for i, held in found.memory.items():
        # The servo's own limits may lie inside the stops, so they are widened.
        table = loose.facts[i].table
        low = table.find(RegisterName.MIN_POSITION_LIMIT)
        high = table.find(RegisterName.MAX_POSITION_LIMIT)
        memory[i] = {**held, low.name: low.range[0], high.name: high.range[1]}
    changes = plan_changes(loose.bus, memory)
    if changes:
        commit(loose.bus, loose.journal_path, loose.path, "", changes, temporary=True)
        loose.read_facts()
    return found


@contextmanager
def restore_encoders(loose: TorqueOffArm, on_status: Callable[[str], None]) -> Generator[None]:
    """Restore the registers of the servos if the ``with`` block ends without a calibration.

    If the arm holds, its torque stays on, and the user is told how to restore them.
    """
    try:
        yield
    except BaseException:
        with contextlib.suppress(BusError):  # the original error already names the silent servos
            _restore_registers(loose, on_status)
        raise


def _restore_registers(loose: TorqueOffArm, on_status: Callable[[str], None]) -> None:
    journal = read_journal(loose.journal_path)
    if journal is None or not journal.temporary:
        return
    name = loose.model.name
    if loose.torque_on_servos():
        on_status(
            f"The servos keep the settings of the search. Calibrate again: ikservo calibrate {name}"
            f"; or undo it: ikservo calibration revert {name}."
        )
        return
    roll_back(loose.bus, loose.journal_path)
    loose.read_facts()
    on_status("The settings of the servos were restored.")


def limited_context(
    loose: TorqueOffArm, state: CalibrationState, known: CalibrationResult, space: CollisionChecker
) -> ArmContext:
    """Return the arm with the limits of the search; torque is not changed."""
    model, bus = loose.model, loose.bus
    own = CalibratedArm(bus, model, ZeroSource.CALIBRATED, known.calibration)
    subjects = {subject.name: subject for subject in state.subjects}
    lags = load_lags(model, model.chain)
    slow_rad_s = model.speed("slow").rad_s
    limits: list[DrivenJoint] = []
    for joint in model.joints:
        lag = lags.get(joint.name, LoadLag())
        speed = slow_rad_s * joint.travel_per_turn / math.tau
        limits.append(
            DrivenJoint(
                own.joint_map(joint),
                _widen_range(subjects[joint.name], state).expected,
                speed * _SPEED_MARGIN,
                lifting_lag_rad=lag.lifting_rad,
                sag_rad=lag.sag_rad,
            )
        )
    shadows = {joint.name: [servo.id for servo in joint.shadows] for joint in model.joints}
    servos = ServoGroup(bus, limits, shadows, bus.clock, model.health)
    zeros = ZeroSource.CALIBRATED
    return ArmContext.build(model, model.chain, servos, bus.port, space, zeros)


def _widen_range(subject: JointUnderCalibration, state: CalibrationState) -> JointUnderCalibration:
    """Return a joint with the range in which its stops are searched for."""
    if not can_probe(subject, state):
        return subject
    beyond = SEARCH_MARGIN_RAD / subject.joint_map.horn_rad_per_tick  # ticks
    free = (
        (subject.ticks_per_turn - 64 - subject.expected_ticks) / 2
        if subject.ticks_per_turn
        else beyond
    )
    margin = min(beyond, free) * subject.joint_map.unit_per_tick
    low, high = subject.expected.lower.value - margin, subject.expected.upper.value + margin
    unit = subject.expected.unit
    return replace(subject, expected=Limits.of(subject.name, low, high, "the search", unit))


_SAMPLES = 30
_MAX_TRIES, _DETOURS = 400, 40
_LIMIT_MARGIN_RAD = 0.26  # distance from the arm file's ends; the true ends are not known yet
_INSIDE_MEASURED_RAD = 0.06  # distance from measured ends
# Within this distance of its end, a joint may touch its neighbour, because many stops work that
# way. It must never touch the table or a keep-out box.
_NEARBY_RAD = 0.22
# Random postures of a long arm above its table seldom have clearance, so the best are improved.
_IMPROVED = 10
_WIDE_RAD, _FINE_RAD = 0.4, 0.03
_ENOUGH_M = 0.004


class PosturePlanner:
    """Search for collision-free postures of an arm that is not calibrated yet."""

    def __init__(self, model: Model) -> None:
        body = collision_body(model)
        self._own_pairs = len(body.pairs)
        self.space = CollisionChecker(body, model.floor_m, model.keep_out)
        self._known = [model.chain_pose(name) for name in model.poses]
        low = np.maximum(model.chain.lower_rad, -np.pi) + _LIMIT_MARGIN_RAD
        high = np.minimum(model.chain.upper_rad, np.pi) - _LIMIT_MARGIN_RAD
        self._low, self._high = np.minimum(low, high), np.maximum(low, high)

    def learn(self, column: int, low: float, high: float) -> None:
        """Use the measured range of a joint; postures may then use it almost up to its ends."""
        low, high = low + _INSIDE_MEASURED_RAD, high - _INSIDE_MEASURED_RAD
        if low < high:
            self._low[column], self._high[column] = low, high

    def path_to_clear(self, column: int, start: float, end: float, present: Vector) -> list[Vector]:
        """Plan a path from ``present`` (dof,) to a posture from which a joint can move to its end.

        The end is a little beyond the expected stop, rad or m.

        Returns:
            Postures (dof,) in order; in the last one the joint is at its start.

        Raises:
            RefusedError: The arm would touch something in every tried posture; the message names
                the contact in the best one.
        """
        search = _JointSearch(column, start, end)
        nearest = (-np.inf, "")
        for candidate in chain([present], self._known, self._improved_postures(search)):
            posture = search.start_posture(candidate)
            nearest = max(nearest, self._min_distance(search, posture))
            if self._can_reach_end(posture, search):
                path = self.find_path(present, posture)
                if path is not None:
                    return path
        distance_m, pair = nearest
        if distance_m >= 0.0:
            raise RefusedError("no free path was found to a posture with room to search")
        raise RefusedError(f"{pair} by {-distance_m * 1e3:.0f} mm in the best posture found")

    def find_path(self, present: Vector, goal: Vector) -> list[Vector] | None:
        """Plan a collision-free path through postures (dof,) to a goal; None if none is found."""
        if self._is_path_free(sample_line(present, goal)):
            return [goal]
        for between in chain(self._known, islice(self._random_postures(), _DETOURS)):
            if self._is_path_free(sample_line(present, between)) and self._is_path_free(
                sample_line(between, goal)
            ):
                return [between, goal]
        return None

    def _random_postures(self) -> Iterator[Vector]:
        random = np.random.default_rng(1)  # the same postures in each run
        while True:
            yield random.uniform(self._low, self._high)

    def _improved_postures(self, search: _JointSearch) -> Iterator[Vector]:
        """Yield the random postures with the most clearance, each improved joint by joint."""
        found = [search.start_posture(row) for row in islice(self._random_postures(), _MAX_TRIES)]
        found.sort(key=lambda posture: self._min_distance(search, posture)[0], reverse=True)
        for posture in found[:_IMPROVED]:
            yield self._improve(posture, search)

    def _improve(self, posture: Vector, search: _JointSearch) -> Vector:
        """Improve a posture until small changes of single joints no longer increase clearance."""
        best, best_m, step = posture, self._min_distance(search, posture)[0], _WIDE_RAD
        while step >= _FINE_RAD and best_m < _ENOUGH_M:
            # The postures (n, dof) in which one of the other joints is moved by a step.
            steps = step * np.vstack([np.eye(len(best)), -np.eye(len(best))])
            steps[:, search.column] = 0.0
            rows = np.clip(best + steps, self._low, self._high)
            rows[:, search.column] = best[search.column]
            distance_m, row = max(
                (self._min_distance(search, row)[0], i) for i, row in enumerate(rows)
            )
            if distance_m > best_m:
                best, best_m = rows[row], distance_m
            else:
                step /= 2
        return best

    def _min_distance(self, search: _JointSearch, posture: Vector) -> tuple[float, str]:
        """Return the smallest distance [m] between parts on the path to an end, and both parts."""
        path = search.sample_path(posture)
        distances_m = self.space.distances(path)
        is_nearby = np.abs(path[:, search.column] - search.start) > search.clear_travel
        distances_m[is_nearby, : self._own_pairs] = np.inf
        least_m = distances_m.min(axis=0)
        pair = int(np.argmin(least_m))
        return float(least_m[pair]), " would overlap ".join(self.space.pairs[pair])

    def _can_reach_end(self, posture: Vector, search: _JointSearch) -> bool:
        obstacles_m = self.space.distances(search.sample_path(posture))[:, self._own_pairs :]
        if not (obstacles_m >= 0.0).all():
            return False
        return self._is_path_free(search.sample_path(posture, search.clear_travel))

    def _is_path_free(self, path: Sequence[Vector] | Matrix) -> bool:
        try:
            self.space.check_path(list(path))
        except RefusedError:
            return False
        return True


@dataclass(frozen=True, slots=True)
class _JointSearch:
    """The motion of one joint to its end, for any posture of the other joints; rad or m."""

    column: int
    start: float
    end: float

    @property
    def clear_travel(self) -> float:
        """The travel before the joint may touch its neighbour."""
        return max(abs(self.end - self.start) - _NEARBY_RAD, 0.0)

    def start_posture(self, posture: Vector) -> Vector:
        """Return a copy of a posture (n,) with the joint at the start of its search."""
        moved = posture.copy()
        moved[self.column] = self.start
        return moved

    def sample_path(self, posture: Vector, max_travel: float = math.inf) -> Matrix:
        """Sample the path (samples, dof), no longer than ``max_travel``."""
        travel = min(abs(self.end - self.start), max_travel)
        rows: Matrix = np.tile(posture, (_SAMPLES, 1))
        rows[:, self.column] += np.linspace(
            0.0, math.copysign(travel, self.end - self.start), _SAMPLES
        )
        return rows


class MeasuredRanges:
    """The file of joints that an automatic calibration has measured, for one arm and adapter.

    Attributes:
        path: The file.
        travels: The measured joints of the file; empty if it is missing or malformed.
        written: Time at which the file was written; empty if there is no file.
    """

    def __init__(self, loose: TorqueOffArm) -> None:
        self._loose, self.path = loose, loose.partial_path
        try:
            found = read_partial(self.path)
        except FileFormatError:  # the joints are measured again, which takes only minutes
            found = None
        if found and found.arm != loose.model.name:
            found = None
        self.written = found.written if found else ""
        rows = found.joints if found else ()
        self.travels = {
            j.name: TickRange(j.low_tick, j.high_tick) for j in rows if self._matches_arm(j)
        }

    def add_joint(self, subject: JointUnderCalibration, travel: TickRange) -> None:
        """Add a joint to the file.

        Raises:
            FileWriteError: The disk is full or not writable.
        """
        self.travels[subject.name] = travel
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
        partial = PartialCalibration(format=1, arm=arm, written=now, joints=tuple(rows))
        write_atomic(self.path, dump_partial(partial))

    def remove_file(self) -> None:
        """Remove the file after a calibration was saved, or to measure all joints again.

        Raises:
            FileWriteError: The file cannot be removed.
        """
        self.travels.clear()
        remove_durably(self.path)

    def _matches_arm(self, joint: StoredJointMeasurement) -> bool:
        facts = self._loose.facts.get(joint.servo_id)
        ids = {j.name: j.servo.id for j in self._loose.model.joints}
        known = ids.get(joint.name) == joint.servo_id and joint.low_tick < joint.high_tick
        return known and facts is not None and facts.table.model_name == joint.servo_model


def with_known_ranges(
    state: CalibrationState, travels: Mapping[str, TickRange]
) -> CalibrationState:
    """Return a calibration state that uses the stored ranges of joints that were measured before.

    A joint whose present position is outside its measured range is measured again.
    """
    subjects: list[JointUnderCalibration] = []
    for subject in state.subjects:
        known = replace(subject, known=travels.get(subject.name))
        try:
            measure_joint(state, known)
        except CalibrationError:
            known = subject
        subjects.append(known)
    return replace(state, subjects=tuple(subjects))
