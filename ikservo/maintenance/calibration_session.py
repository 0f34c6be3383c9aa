"""A calibration session by hand: torque off, joint readings, save, adopt, merge."""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Generator, Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

from ikservo.arm.calibrated_arm import (
    calibrated_limits,
    check_calibration_matches,
    check_joints_match,
    check_servo_models,
    limit_to_one_turn,
    registers_allow,
    serial_number_of,
)
from ikservo.arm.opening import open_bus
from ikservo.calibration import Limits
from ikservo.calibration.calibration_file import (
    calibration_path,
    calibrations_of,
    dump_calibration,
    journal_path,
    load_calibration,
    partial_path,
    read_calibration,
    save_calibration,
)
from ikservo.calibration.homing import TickRange, encoder_tick
from ikservo.calibration.joint_map import encoder_of
from ikservo.calibration.procedure import CalibrationState
from ikservo.calibration.range_tracker import JointUnderCalibration
from ikservo.calibration.records import CalibratedJoint, CalibratedServo, Calibration
from ikservo.calibration.result import CalibrationMetadata, CalibrationResult, build_calibration
from ikservo.calibration.servo_config import (
    RegisterMismatch,
    ServoConfig,
    raise_on_mismatch,
    read_servo_config,
    register_mismatches,
    same_direction,
)
from ikservo.calibration.transaction import commit, plan_changes, recover
from ikservo.errors import CalibrationError, FileFormatError
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.torque import torque_off
from ikservo.model import Model, ModelJoint
from ikservo.registers import Family, RegisterName

__all__ = [
    "TorqueOffArm",
    "adopt_calibration",
    "base_calibration",
    "find_adoptable",
    "find_replaced_zeros",
    "load_own_calibration",
    "lost_geometry_warning",
    "merge_outcome",
    "open_torque_off",
    "pull",
    "push",
    "register_differences",
    "rest_pose_violations",
]


READ_PERIOD_S = 0.02
_MAX_FAILURES = 25


class TorqueOffArm:
    """The servos of an arm while it is calibrated; see ``open_torque_off``.

    Attributes:
        model: What the arm file says.
        bus: The line.
        facts: Every servo as it was found, by id.
        serial_number: Of the USB adapter; empty where it has none.
        settled: What was cleared up of an earlier calibration; empty where nothing was.
    """

    def __init__(self, model: Model, bus: ServoBus, *, settled: bool = True) -> None:
        self.model, self.bus = model, bus
        self.serial_number = serial_number_of(bus.port.name)
        self.settled = recover(bus, self.journal_path) if settled else ""
        self.facts = {servo_id: read_servo_config(bus, servo_id) for servo_id in bus.servos}
        self._failures = 0
        self._next_s = bus.clock.now_s()

    @property
    def path(self) -> Path:
        """Return where its calibration lies."""
        return calibration_path(self.model.name, self.serial_number)

    @property
    def journal_path(self) -> Path:
        """Return where it is noted what is being written."""
        return journal_path(self.model.name, self.serial_number)

    @property
    def partial_path(self) -> Path:
        """Return where an interrupted self-calibration keeps the joints it has measured."""
        return partial_path(self.model.name, self.serial_number)

    def make_subjects(
        self,
        pose: str,
        known: Mapping[str, TickRange] | None = None,
        only: Collection[str] = (),
    ) -> list[JointUnderCalibration]:
        """Return the joints to be calibrated from a named pose; all of them if ``only`` is empty.

        Raises:
            UnknownNameError: The arm has no such pose.
        """
        positions = self.model.pose(pose)
        return [
            self._make_subject(joint, positions[joint.name], (known or {}).get(joint.name))
            for joint in self.model.joints
            if not only or joint.name in only
        ]

    def torque_on_servos(self) -> list[str]:
        """Return the servos whose torque is on."""
        torque = self.bus.sync_read(
            self.bus.servos, RegisterName.TORQUE_ENABLE, raw=True
        ).require_all()
        return [str(self.bus.servos[i]) for i, on in torque.items() if on]

    def disable_torque(self) -> None:
        """Switch torque off; whoever calibrates holds the arm.

        Raises:
            BusError: A servo did not hear; the others are off.
        """
        for error in torque_off(self.bus, self.bus.servos).values():
            raise error

    def read_ticks(self) -> tuple[float, dict[int, int]] | None:
        """Wait for the next beat; return time [s] and bare ticks by id, or None if one is missing.

        Raises:
            BusError: Servos have been silent for half a second.
        """
        reading = self.read_positions()
        if reading is None:
            return None
        at_s, ticks = reading
        return at_s, {i: _encoder_tick(self.facts[i], tick) for i, tick in ticks.items()}

    def read_positions(self) -> tuple[float, dict[int, int]] | None:
        """Wait for the next beat; return time [s] and ticks as the servos report them by id.

        Raises:
            BusError: Servos have been silent for half a second.
        """
        clock = self.bus.clock
        clock.sleep_until(self._next_s)
        self._next_s = max(self._next_s + READ_PERIOD_S, clock.now_s())
        readings = self.bus.sync_read(self.bus.servos, RegisterName.PRESENT_POSITION, raw=True)
        self._failures = self._failures + 1 if readings.errors else 0
        if self._failures > _MAX_FAILURES:
            readings.require_all()
        if readings.errors:
            return None
        return clock.now_s(), dict(readings.values)

    def build_calibration(
        self,
        wizard: CalibrationState,
        pose: str,
        written: datetime,
        *,
        write_limits: bool = False,
        user: Mapping[str, Limits] | None = None,
        facts: Mapping[int, ServoConfig] | None = None,
    ) -> CalibrationResult:
        """Work out the calibration; see ``ikservo.calibration.result``.

        ``facts`` is how the servos should be taken to be, where that is not as they were found.
        """
        about = CalibrationMetadata(
            arm=self.model.name,
            written=written.replace(microsecond=0),
            tool_version=version("ikservo"),
            usb_serial_number=self.serial_number,
            family=next(iter(self.facts.values())).table.family,
            anchor_pose=pose,
        )
        found = facts or self.facts
        return build_calibration(wizard, found, about, write_limits=write_limits, user=user)

    def register_limit_warnings(self, outcome: CalibrationResult) -> Iterator[str]:
        """Yield whose range the servo's own limits would cut, one line each."""
        for joint in self.model.joints:
            own = outcome.calibration.joint(joint.name)
            if own is None or own.extended:
                continue
            joint_map = own.joint_map(joint.joint_map)
            limits = outcome.calibration.narrow_limits(own, joint.limits)
            held = [own.servo.holds[name] for name in _limit_names(self.facts[own.servo.id])]
            if any(held) and not registers_allow(joint_map, limits, (held[0], held[1])):
                yield (
                    f"{joint.name}: its servo's own limits, {held[0]} to {held[1]}, are narrower "
                    "than the range found; replace them with --write-limits."
                )

    def save(self, outcome: CalibrationResult) -> Path:
        """Write the servos and the file as one, read everything back, and return the file.

        Raises:
            IkservoError: It failed; either nothing is changed, or the message says how to go on.
        """
        changes = plan_changes(self.bus, outcome.memory)
        text = dump_calibration(outcome.calibration)
        commit(self.bus, self.journal_path, self.path, text, changes)
        self.facts = {
            servo_id: read_servo_config(self.bus, servo_id) for servo_id in self.bus.servos
        }
        raise_on_mismatch(register_mismatches(outcome.calibration, self.facts))
        return self.path

    def _make_subject(
        self, joint: ModelJoint, pose: float, known: TickRange | None
    ) -> JointUnderCalibration:
        encoder = encoder_of(self.bus.servos[joint.servo.id].table)
        shadows = tuple(servo.id for servo in joint.shadows)
        turn = encoder.ticks if encoder.wraps else 0
        expected = limit_to_one_turn(joint.limits, joint.joint_map, encoder)
        return JointUnderCalibration(joint.joint_map, turn, expected, pose, shadows, known)


@contextmanager
def open_torque_off(
    model: Model, port: str | None, *, settled: bool = True
) -> Generator[TorqueOffArm]:
    """Open an arm for calibration; torque stays as it is until ``let_go``.

    Args:
        model: The arm.
        port: See ``choose_port``.
        settled: Whether a writing that was broken off must be cleared up first.

    Raises:
        PortError: No port, or it cannot be opened.
        ServoSilentError: A servo does not answer; names all that do not.
        CalibrationError: A servo is of another model, or a calibration is half written.
    """
    with open_bus(model, port) as bus:
        check_servo_models(bus)
        bus.load_return_delays()
        yield TorqueOffArm(model, bus, settled=settled)


def _limit_names(facts: ServoConfig) -> tuple[str, str]:
    table = facts.table
    low, high = (
        table.find(RegisterName.MIN_POSITION_LIMIT),
        table.find(RegisterName.MAX_POSITION_LIMIT),
    )
    return low.name, high.name


def _encoder_tick(facts: ServoConfig, tick: int) -> int:
    return encoder_tick(facts.table.family, tick, facts.offset, encoder_of(facts.table))


def load_own_calibration(loose: TorqueOffArm) -> Calibration:
    """Return the arm's calibration.

    Raises:
        CalibrationError: There is none.
        FileFormatError: It is spoiled.
    """
    name = loose.model.name
    calibration = load_calibration(name, loose.serial_number)
    if calibration is None:
        others = calibrations_of(name)
        adopt = f" Or adopt that of another adapter: ikservo calibration adopt {name}"
        raise CalibrationError(
            f"{name} is not calibrated: there is no {loose.path}.",
            f"Calibrate it: ikservo calibrate {name}.{adopt if others else ''}",
        )
    return calibration


def register_differences(loose: TorqueOffArm) -> list[RegisterMismatch]:
    """Return where the servos hold other numbers than the file."""
    return list(register_mismatches(load_own_calibration(loose), loose.facts))


def lost_geometry_warning(loose: TorqueOffArm) -> Iterator[str]:
    """Yield what the calibration before knows and a new one does not, one line each."""
    with contextlib.suppress(FileFormatError):  # of one that is spoiled nothing is lost
        before = load_calibration(loose.model.name, loose.serial_number)
        if before and before.geometry:
            yield (
                "The link and base corrections of the touch-off of "
                f"{before.geometry.touched:%Y-%m-%d} are lost with the old zeros. "
                f"Repeat the touch-off: ikservo calibrate {loose.model.name} --touch"
            )


def push(loose: TorqueOffArm) -> Path:
    """Make the servos hold what the file says; torque goes off first.

    Raises:
        CalibrationError: There is no file, or it is of other servos than the arm file's.
        IkservoError: It failed; nothing is changed, or the message says how to go on.
    """
    calibration = _load_matching_calibration(loose)
    memory = {s.id: s.holds for joint in calibration.joints for s in joint.servos}
    loose.disable_torque()
    return loose.save(CalibrationResult(calibration, memory))


def pull(loose: TorqueOffArm) -> Path:
    """Make the file say what the servos hold; zeros and travels move with the offsets.

    Raises:
        CalibrationError: There is no file, it is of other servos than the arm file's, or the
            servos count the other way round, not at all, or with a seam in a joint's travel.
    """
    calibration = _load_matching_calibration(loose)
    joints = tuple(_shift_joint(joint, loose.facts) for joint in calibration.joints)
    now = datetime.now(UTC).replace(microsecond=0)
    return save_calibration(calibration.model_copy(update={"joints": joints, "written": now}))


def _load_matching_calibration(loose: TorqueOffArm) -> Calibration:
    calibration = load_own_calibration(loose)
    check_calibration_matches(calibration, loose.model, loose.serial_number)
    return calibration


def _shift_joint(joint: CalibratedJoint, facts: Mapping[int, ServoConfig]) -> CalibratedJoint:
    lead = facts[joint.servo.id]
    if not all(same_direction(facts[servo.id], servo.holds) for servo in joint.servos):
        raise CalibrationError(
            f"{joint.name} has another count direction than when calibrated; "
            "its sign and zero are invalid.",
            "Write the file's values into the servos instead: ikservo calibration push. "
            "Or measure again: ikservo calibrate",
        )
    shift = _count_shift(joint, lead)
    low, high = (tick + shift for tick in joint.travel_ticks)
    if not lead.is_multi_turn and not 0 <= low < high < encoder_of(lead.table).ticks:
        raise CalibrationError(
            f"With the servo's present offset, the encoder of {joint.name} wraps inside its range.",
            "Write the file's values into the servos instead: ikservo calibration push",
        )
    return joint.model_copy(
        update={
            "zero_tick": joint.zero_tick + shift,
            "travel_ticks": (low, high),
            "extended": lead.is_multi_turn,
            "servo": _with_present_registers(joint.servo, facts),
            "shadows": tuple(_with_present_registers(shadow, facts) for shadow in joint.shadows),
        }
    )


def _count_shift(joint: CalibratedJoint, lead: ServoConfig) -> int:
    """Return how far a servo's count has moved since the file was written."""
    moved = lead.registers.get("homing_offset", 0) - joint.servo.holds.get("homing_offset", 0)
    shift = -moved if lead.table.family is Family.FEETECH_STS else moved
    turn = encoder_of(lead.table)
    if not turn.wraps or joint.extended:
        return shift
    # Where the count now begins elsewhere the travel may have moved by a turn.
    low = joint.travel_ticks[0] + shift
    return shift + (low % turn.ticks - low)


def _with_present_registers(
    servo: CalibratedServo, facts: Mapping[int, ServoConfig]
) -> CalibratedServo:
    return servo.model_copy(update={"holds": dict(facts[servo.id].registers)})


def find_adoptable(loose: TorqueOffArm, path: Path | None = None) -> tuple[Path, Calibration]:
    """Return the calibration that the servos on this line agree with, and where it lies.

    Args:
        loose: The arm.
        path: The file; None to look at what was made for this arm on other adapters.

    Raises:
        CalibrationError: None fits, or several do; says why.
        FileFormatError: The file is spoiled.
    """
    paths = [path] if path else [p for p in calibrations_of(loose.model.name) if p != loose.path]
    found = [(candidate, read_calibration(candidate)) for candidate in paths]
    doubts = {candidate: next(_find_mismatches(loose, c), "") for candidate, c in found}
    fitting = [row for row in found if not doubts[row[0]]]
    if len(fitting) == 1:
        return fitting[0]
    if fitting:
        names = ", ".join(str(candidate) for candidate, _ in fitting)
        raise CalibrationError(f"Several calibrations fit: {names}.", "Choose one: --from FILE")
    reasons = " ".join(f"{p}: {doubt}" for p, doubt in doubts.items())
    raise CalibrationError(
        f"No calibration of another adapter fits this arm. {reasons}".rstrip(),
        f"Calibrate it: ikservo calibrate {loose.model.name}",
    )


def adopt_calibration(loose: TorqueOffArm, calibration: Calibration) -> Path:
    """Save a calibration as that of the arm on this adapter; the one before is kept beside it."""
    own = {"usb_serial_number": loose.serial_number}
    return save_calibration(calibration.model_copy(update=own))


def _find_mismatches(loose: TorqueOffArm, calibration: Calibration) -> Iterator[str]:
    """Yield why a calibration cannot be this arm's."""
    if calibration.arm != loose.model.name:
        yield f"made for {calibration.arm}."
    try:
        check_joints_match(calibration, loose.model, "it")
    except CalibrationError as error:
        yield error.message
    yield from (f"{c}." for c in register_mismatches(calibration, loose.facts))


_USER_KEYS = ("user_lower_deg", "user_upper_deg", "user_lower_m", "user_upper_m")


def base_calibration(loose: TorqueOffArm, joints: Collection[str]) -> Calibration:
    """Return the calibration of which some joints are to be replaced.

    Raises:
        CalibrationError: There is none, it is another arm's, or the servos of the joints that
            are kept contradict it.
        FileFormatError: It is damaged.
    """
    calibration = load_own_calibration(loose)
    check_calibration_matches(calibration, loose.model, loose.serial_number)
    kept = tuple(joint for joint in calibration.joints if joint.name not in joints)
    raise_on_mismatch(
        register_mismatches(calibration.model_copy(update={"joints": kept}), loose.facts)
    )
    return calibration


def merge_outcome(base: Calibration, outcome: CalibrationResult) -> CalibrationResult:
    """Return an outcome of some joints completed by the other joints of a calibration.

    Geometry found by a touch-off stays, as do ranges that the person has set.
    """
    new = {joint.name: joint for joint in outcome.calibration.joints}
    joints = tuple(
        _with_user_range(new[old.name], old) if old.name in new else old for old in base.joints
    )
    update = {"joints": joints, "geometry": base.geometry}
    return CalibrationResult(outcome.calibration.model_copy(update=update), outcome.memory)


def find_replaced_zeros(base: Calibration, joints: Collection[str]) -> Iterator[str]:
    """Yield what of a touch-off is lost by calibrating some joints again, one line each."""
    if base.geometry:
        yield (
            f"Zeros from the touch-off of {base.geometry.touched:%Y-%m-%d} are replaced for "
            f"{', '.join(joints)}. Touch off again: ikservo calibrate {base.arm} --touch"
        )


def _with_user_range(new: CalibratedJoint, old: CalibratedJoint) -> CalibratedJoint:
    if new.user_range() != (None, None):
        return new
    return new.model_copy(update={key: getattr(old, key) for key in _USER_KEYS})


def rest_pose_violations(model: Model, calibration: Calibration) -> list[str]:
    """Return which joints of the rest pose lie outside their calibrated limits, in words.

    Raises:
        CalibrationError: A joint has no range left.
    """
    found: list[str] = []
    for own in calibration.joints:
        joint, at = model.joint(own.name), model.pose("rest").get(own.name)
        limits = calibrated_limits(calibration, own, joint)
        if at is None or limits.contains(at):
            continue
        limit = limits.upper if at > limits.upper.value else limits.lower
        say = joint.joint_map.format
        found.append(
            f"{own.name}: the rest pose is at {say(at)}, outside its limit of {say(limit.value)} "
            f"({limit.source}); the arm is lowered to the limit."
        )
    return found
