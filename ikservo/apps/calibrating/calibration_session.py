"""A calibration session with torque off: read joints, and save, adopt or merge calibrations."""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Generator, Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

from ikservo.apps.calibrating.by_hand_procedure import CalibrationState
from ikservo.apps.calibrating.calibration_result import (
    CalibrationMetadata,
    CalibrationResult,
    build_calibration,
)
from ikservo.arm.opening import open_bus
from ikservo.calibration import Limits
from ikservo.calibration.calibration_file import (
    dump_calibration,
    load_calibration,
    read_calibration,
    save_calibration,
)
from ikservo.calibration.homing import TickRange, encoder_tick
from ikservo.calibration.joint_map import encoder_of
from ikservo.calibration.paths import calibration_path, calibrations_of, journal_path, partial_path
from ikservo.calibration.records import CalibratedJoint, CalibratedServo, Calibration
from ikservo.calibration.servo_config import (
    RegisterMismatch,
    ServoConfig,
    raise_on_mismatch,
    read_servo_config,
    register_mismatches,
    same_direction,
)
from ikservo.calibration.transaction import commit, plan_changes, recover
from ikservo.calibration.uncalibrated_joint import JointUnderCalibration
from ikservo.control.stop_requests import exiting_on_signals
from ikservo.errors import CalibrationError, FileFormatError
from ikservo.files.public_source import public_source
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.port_names import serial_number_of
from ikservo.hardware.torque import torque_off
from ikservo.model import Model
from ikservo.planning.calibrated_arm import (
    calibrated_limits,
    check_calibration_matches,
    check_joints_match,
    check_servo_models,
    limit_to_one_turn,
    registers_allow,
)
from ikservo.registers import Family, RegisterName

READ_PERIOD_S = 0.02
_MAX_FAILURES = 25


class TorqueOffArm:
    """The servos of an arm while it is calibrated; see ``open_torque_off``.

    Attributes:
        model: The arm file's model.
        bus: The servo bus.
        facts: The configuration that was read from every servo, by id.
        serial_number: The serial number of the USB adapter; empty if it has none.
        settled: Text about the recovery of an interrupted write; empty if there was none.
    """

    def __init__(self, model: Model, bus: ServoBus, *, settled: bool = True) -> None:
        self.model, self.bus = model, bus
        self.serial_number = serial_number_of(bus.port.name)
        self.settled = recover(bus, self.journal_path, calibrating=True) if settled else ""
        self.read_facts()
        self._failures = 0
        self._next_s = bus.clock.now_s()

    @property
    def path(self) -> Path:
        """The path of the calibration file."""
        return calibration_path(self.model.name, self.serial_number)

    @property
    def journal_path(self) -> Path:
        """The path of the journal of an interrupted write."""
        return journal_path(self.model.name, self.serial_number)

    @property
    def partial_path(self) -> Path:
        """The file of the joints that an interrupted automatic calibration measured."""
        return partial_path(self.model.name, self.serial_number)

    def make_subjects(
        self, pose: str, known: Mapping[str, TickRange] | None = None, only: Collection[str] = ()
    ) -> tuple[JointUnderCalibration, ...]:
        """Return the joints to calibrate, given a named pose; all joints if ``only`` is empty.

        Raises:
            UnknownNameError: The arm has no such pose.
        """
        positions = self.model.pose(pose)
        subjects: list[JointUnderCalibration] = []
        for joint in self.model.joints:
            if only and joint.name not in only:
                continue
            encoder = encoder_of(self.bus.servos[joint.servo.id].table)
            subjects.append(
                JointUnderCalibration(
                    joint.joint_map,
                    encoder.ticks if encoder.wraps else 0,
                    limit_to_one_turn(joint.limits, joint.joint_map, encoder),
                    positions[joint.name],
                    tuple(servo.id for servo in joint.shadows),
                    (known or {}).get(joint.name),
                )
            )
        return tuple(subjects)

    def read_facts(self) -> None:
        """Read the configuration of every servo."""
        self.facts = {i: read_servo_config(self.bus, i) for i in self.bus.servos}

    def torque_on_servos(self) -> list[str]:
        """Read which servos have their torque on."""
        readings = self.bus.sync_read(self.bus.servos, RegisterName.TORQUE_ENABLE, raw=True)
        return [str(self.bus.servos[i]) for i, on in readings.require_all().items() if on]

    def disable_torque(self) -> None:
        """Switch torque off; the user must hold the arm.

        Raises:
            BusError: A servo does not reply; the torque of the other servos is off.
        """
        for error in torque_off(self.bus, self.bus.servos).values():
            raise error

    def read_ticks(self) -> tuple[float, dict[int, int]] | None:
        """Wait for the next period; return time [s] and raw ticks by id, or None if any is missing.

        Raises:
            BusError: Servos have been silent for half a second.
        """
        if (reading := self.read_positions()) is None:
            return None
        at_s, ticks = reading
        raw: dict[int, int] = {}
        for i, tick in ticks.items():
            table, offset = self.facts[i].table, self.facts[i].offset
            raw[i] = encoder_tick(table.family, tick, offset, encoder_of(table))
        return at_s, raw

    def read_positions(self) -> tuple[float, dict[int, int]] | None:
        """Wait for the next period; return time [s] and ticks by id, or None if any is missing.

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
        return None if readings.errors else (clock.now_s(), dict(readings.values))

    def build_calibration(
        self,
        state: CalibrationState,
        pose: str,
        written: datetime,
        *,
        write_limits: bool = False,
        user: Mapping[str, Limits] | None = None,
        facts: Mapping[int, ServoConfig] | None = None,
    ) -> CalibrationResult:
        """Build the calibration; ``facts`` replaces the configuration read from the servos."""
        metadata = CalibrationMetadata(
            arm=self.model.name,
            written=written.replace(microsecond=0),
            tool_version=version("ikservo"),
            usb_serial_number=self.serial_number,
            family=next(iter(self.facts.values())).table.family,
            anchor_pose=pose,
        )
        facts = facts or self.facts
        return build_calibration(state, facts, metadata, write_limits=write_limits, user=user)

    def register_limit_warnings(self, outcome: CalibrationResult) -> Iterator[str]:
        """Yield a warning for each joint whose range the servo's own limits would reduce."""
        for joint in self.model.joints:
            own = outcome.calibration.joint(joint.name)
            if own is None or own.extended:
                continue
            joint_map = own.joint_map(joint.joint_map)
            limits = outcome.calibration.narrow_limits(own, joint.limits)
            names = (RegisterName.MIN_POSITION_LIMIT, RegisterName.MAX_POSITION_LIMIT)
            table = self.facts[own.servo.id].table
            low, high = (own.servo.holds[table.find(name).name] for name in names)
            if (low or high) and not registers_allow(joint_map, limits, (low, high)):
                yield (
                    f"{joint.name}: its servo's own limits, {low} to {high}, are narrower "
                    "than the range found; replace them with --write-limits."
                )

    def save(self, outcome: CalibrationResult) -> Path:
        """Write servos and file as one transaction, verify them, and return the file.

        Raises:
            IkservoError: Writing failed; nothing is changed, or the message says how to continue.
        """
        changes = plan_changes(self.bus, outcome.memory)
        text = dump_calibration(outcome.calibration)
        commit(self.bus, self.journal_path, self.path, text, changes)
        self.read_facts()
        raise_on_mismatch(register_mismatches(outcome.calibration, self.facts))
        return self.path


@contextmanager
def open_torque_off(
    model: Model, port: str | None, *, settled: bool = True
) -> Generator[TorqueOffArm]:
    """Open an arm for calibration without changing its torque.

    A signal, such as Ctrl-C, takes effect after a running write. With ``settled``, an interrupted
    write is recovered first.

    Raises:
        PortError: There is no port, or it cannot be opened.
        ServoSilentError: A servo does not reply.
        CalibrationError: A servo is of a different model, or a write was interrupted.
    """
    with exiting_on_signals(), open_bus(model, port) as bus:
        check_servo_models(bus)
        bus.load_return_delays()
        yield TorqueOffArm(model, bus, settled=settled)


def load_own_calibration(loose: TorqueOffArm) -> Calibration:
    """Load the arm's calibration.

    Raises:
        CalibrationError: The arm has no calibration.
        FileFormatError: The file is malformed.
    """
    name = loose.model.name
    calibration = load_calibration(name, loose.serial_number)
    if calibration is None:
        others = calibrations_of(name)
        adopt = (
            f" Or adopt the calibration made with another adapter: ikservo calibration adopt {name}"
        )
        hint = f"Calibrate it: ikservo calibrate {name}.{adopt if others else ''}"
        raise CalibrationError(f"{name} is not calibrated: there is no {loose.path}.", hint)
    return calibration


def register_differences(loose: TorqueOffArm) -> list[RegisterMismatch]:
    """Return the servo registers that differ from the calibration file."""
    return list(register_mismatches(load_own_calibration(loose), loose.facts))


def find_lost_camera(before: Calibration) -> Iterator[str]:
    """Yield a warning for each camera whose calibration is lost with the old zeros."""
    for name, camera in before.cameras_by_name.items():
        named = f" --camera-name {name}" if name else ""
        yield (
            f"The camera calibration from {camera.seen:%Y-%m-%d} used the old zeros and is "
            f"lost with them. Calibrate the camera again: ikservo calibrate {before.arm} "
            f"--camera {public_source(camera.source)}{named}"
        )


def lost_geometry_warning(loose: TorqueOffArm) -> Iterator[str]:
    """Yield warnings if a new calibration discards touch-off corrections or a camera."""
    with contextlib.suppress(FileFormatError):  # a malformed file has nothing to lose
        before = load_calibration(loose.model.name, loose.serial_number)
        if before:
            yield from find_lost_camera(before)
        if before and before.geometry:
            yield (
                "The link and base corrections of the touch-off of "
                f"{before.geometry.touched:%Y-%m-%d} are lost with the old zeros. "
                f"Repeat the touch-off: ikservo calibrate {loose.model.name} --touch"
            )


def push_calibration(loose: TorqueOffArm) -> Path:
    """Write the file's register values into the servos; torque is switched off first.

    Raises:
        CalibrationError: There is no file, or its servos differ from those in the arm file.
        IkservoError: The transfer failed; nothing is changed, or the message says how to continue.
    """
    calibration = _load_matching_calibration(loose)
    memory = {s.id: s.holds for joint in calibration.joints for s in joint.servos}
    loose.disable_torque()
    return loose.save(CalibrationResult(calibration, memory))


def pull_calibration(loose: TorqueOffArm) -> Path:
    """Write the servos' register values into the file; zeros and travels shift with the offsets.

    Raises:
        CalibrationError: There is no file, its servos differ from those in the arm file, the count
            direction has changed, or a count wraps inside a joint's range.
    """
    calibration = _load_matching_calibration(loose)
    joints = tuple(_shift_joint(joint, loose.facts) for joint in calibration.joints)
    update = {"joints": joints, "written": datetime.now(UTC).replace(microsecond=0)}
    return save_calibration(calibration.model_copy(update=update))


def _load_matching_calibration(loose: TorqueOffArm) -> Calibration:
    calibration = load_own_calibration(loose)
    check_calibration_matches(calibration, loose.model, loose.serial_number)
    return calibration


def _shift_joint(joint: CalibratedJoint, facts: Mapping[int, ServoConfig]) -> CalibratedJoint:
    lead = facts[joint.servo.id]
    if not all(same_direction(facts[servo.id], servo.holds) for servo in joint.servos):
        raise CalibrationError(
            f"{joint.name} counts in the opposite direction from when it was calibrated; "
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
            "servo": _with_registers(joint.servo, facts),
            "shadows": tuple(_with_registers(shadow, facts) for shadow in joint.shadows),
        }
    )


def _count_shift(joint: CalibratedJoint, lead: ServoConfig) -> int:
    """Compute the shift of a servo's count since the file was written."""
    moved = lead.registers.get("homing_offset", 0) - joint.servo.holds.get("homing_offset", 0)
    shift = -moved if lead.table.family is Family.FEETECH_STS else moved
    turn = encoder_of(lead.table)
    if not turn.wraps or joint.extended:
        return shift
    # If the count starts elsewhere, the travel may have moved by a revolution.
    low = joint.travel_ticks[0] + shift
    return shift + (low % turn.ticks - low)


def _with_registers(servo: CalibratedServo, facts: Mapping[int, ServoConfig]) -> CalibratedServo:
    return servo.model_copy(update={"holds": dict(facts[servo.id].registers)})


def find_adoptable(loose: TorqueOffArm, path: Path | None = None) -> tuple[Path, Calibration]:
    """Find the calibration that matches the servos on this bus; return its path and content.

    Without a path, the files of this arm on other adapters are searched.

    Raises:
        CalibrationError: No calibration fits, or several do.
        FileFormatError: The file is malformed.
    """
    paths = [path] if path else [p for p in calibrations_of(loose.model.name) if p != loose.path]
    found = [(candidate, read_calibration(candidate)) for candidate in paths]
    mismatches = {candidate: next(find_mismatches(loose, c), "") for candidate, c in found}
    fitting = [row for row in found if not mismatches[row[0]]]
    if len(fitting) == 1:
        return fitting[0]
    if fitting:
        names = ", ".join(str(candidate) for candidate, _ in fitting)
        raise CalibrationError(f"Several calibrations fit: {names}.", "Choose one: --from FILE")
    reasons = " ".join(f"{p}: {reason}" for p, reason in mismatches.items())
    text = f"No calibration made with another adapter fits this arm. {reasons}".rstrip()
    raise CalibrationError(text, f"Calibrate it: ikservo calibrate {loose.model.name}")


def check_adoptable(loose: TorqueOffArm, path: Path, calibration: Calibration) -> None:
    """Check that a calibration matches the servos on this bus.

    Raises:
        CalibrationError: The calibration does not match; the message says why.
    """
    reason = next(find_mismatches(loose, calibration), "")
    if reason:
        hint = f"Calibrate it: ikservo calibrate {loose.model.name}"
        raise CalibrationError(f"The calibration in {path} does not fit this arm. {reason}", hint)


def adopt_calibration(loose: TorqueOffArm, calibration: Calibration) -> Path:
    """Save a calibration for this adapter; keep a copy of the previous one."""
    update = {"usb_serial_number": loose.serial_number}
    return save_calibration(calibration.model_copy(update=update))


def find_mismatches(loose: TorqueOffArm, calibration: Calibration) -> Iterator[str]:
    """Yield the reasons why a calibration does not match this arm."""
    if calibration.arm != loose.model.name:
        yield f"It was made for {calibration.arm}."
    try:
        check_joints_match(calibration, loose.model, "it")
    except CalibrationError as error:
        yield error.message
    yield from (f"{c}." for c in register_mismatches(calibration, loose.facts))


_USER_KEYS = ("user_lower_deg", "user_upper_deg", "user_lower_m", "user_upper_m")


def base_calibration(loose: TorqueOffArm, joints: Collection[str]) -> Calibration:
    """Load the calibration in which some joints are to be replaced.

    Raises:
        CalibrationError: There is no calibration, it belongs to another arm, or the servos of the
            joints that are kept contradict it.
        FileFormatError: The file is malformed.
    """
    calibration = _load_matching_calibration(loose)
    kept = tuple(joint for joint in calibration.joints if joint.name not in joints)
    raise_on_mismatch(
        register_mismatches(calibration.model_copy(update={"joints": kept}), loose.facts)
    )
    return calibration


def merge_outcome(base: Calibration, outcome: CalibrationResult) -> CalibrationResult:
    """Add the other joints, the geometry and the user limits of ``base`` to a partial result."""
    new = {joint.name: joint for joint in outcome.calibration.joints}
    joints: list[CalibratedJoint] = []
    for old in base.joints:
        joint = new.get(old.name)
        if joint is not None and joint.user_range() == (None, None):
            joint = joint.model_copy(update={key: getattr(old, key) for key in _USER_KEYS})
        joints.append(joint or old)
    update = {"joints": tuple(joints), "geometry": base.geometry}
    return CalibrationResult(outcome.calibration.model_copy(update=update), outcome.memory)


def find_replaced_zeros(base: Calibration, joints: Collection[str]) -> Iterator[str]:
    """Yield a warning for each saved result that is lost when some joints are recalibrated."""
    yield from find_lost_camera(base)
    if base.geometry:
        yield (
            f"Zeros from the touch-off of {base.geometry.touched:%Y-%m-%d} are replaced for "
            f"{', '.join(joints)}. Touch off again: ikservo calibrate {base.arm} --touch"
        )


def rest_pose_violations(model: Model, calibration: Calibration) -> list[str]:
    """Describe the joints of the rest pose that are outside their calibrated limits.

    Raises:
        CalibrationError: A joint has no range left.
    """
    found: list[str] = []
    for own in calibration.joints:
        joint, position = model.joint(own.name), model.pose("rest").get(own.name)
        limits = calibrated_limits(calibration, own, joint)
        if position is None or limits.contains(position):
            continue
        limit = limits.upper if position > limits.upper.value else limits.lower
        at, end = joint.joint_map.format(position), joint.joint_map.format(limit.value)
        found.append(
            f"{own.name}: the rest pose is at {at}, outside its limit of {end} "
            f"({limit.source}); the arm is lowered to the limit."
        )
    return found
