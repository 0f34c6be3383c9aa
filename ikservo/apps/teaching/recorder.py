"""Record an arm at a fixed rate, as JSON lines, or as MCAP if the file ends in ``.mcap``."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from ikservo.apps.teaching.live_view import FoxgloveServer
from ikservo.apps.teaching.mcap_recording import (
    MAGIC,
    McapFile,
    MessageSink,
    RecordedArm,
    RosRecordingWriter,
    read_mcap,
)
from ikservo.apps.teaching.recording import (
    ArmSample,
    Recording,
    RecordingHeader,
    RecordingWriter,
    read_json_lines,
)
from ikservo.arguments import check_callable, parse_number
from ikservo.arm.arm import Arm
from ikservo.arm.arm_protocol import OpenArm
from ikservo.arm.motion_runner import MotionRunner
from ikservo.arm.opening import resolve_port
from ikservo.arm.other_process import query_state
from ikservo.calibration.calibration_file import dump_calibration, load_calibration
from ikservo.calibration.paths import calibration_path
from ikservo.clock import Clock, Rate, RealClock
from ikservo.errors import BadValueError, FileFormatError, IkservoError, InputError
from ikservo.files.reading import parse_path, require_file
from ikservo.hardware.port_names import serial_number_of
from ikservo.kinematics import Chain
from ikservo.model import Model
from ikservo.planning.calibrated_arm import ZeroSource
from ikservo.planning.context import ArmContext

MCAP_SUFFIX = ".mcap"
_HEALTH_PERIOD_S = 1.0


@dataclass(frozen=True, slots=True)
class RecordResult:
    """Result of a recording; the duration is the time from the first to the last sample."""

    path: Path
    samples: int
    duration_s: float


@dataclass(frozen=True, slots=True)
class RecordSettings:
    """The options of ``arm.record``; see `record_open_arm`."""

    path: Path | str
    duration_s: float | None = None
    until: Callable[[], bool] | None = None
    period_s: float = 0.02
    overwrite: bool = False
    foxglove_port: int | None = None

    @property
    def max_s(self) -> float:
        """The longest duration.

        Raises:
            InputError: No end is given, or the end is not after the start.
        """
        if self.duration_s is None and self.until is None:
            raise InputError("The recording has no end.", "Give duration_s or until.")
        if self.duration_s is None:
            return math.inf
        max_s = parse_number("The duration", self.duration_s)
        if not max_s > 0.0:
            raise BadValueError("The duration", f"{max_s:g} s", "more than 0 s")
        return max_s


class _SampleWriter(Protocol):
    samples: int

    def write_sample(self, time_s: float, sample: ArmSample, /) -> None: ...


def recording_header(model: Model, period_s: float) -> RecordingHeader:
    """Return the header of a recording of an arm.

    Raises:
        BadValueError: The period is out of its range.
    """
    period_s = parse_number("The period", period_s)
    if not 0.002 <= period_s <= 10.0:
        raise BadValueError("The period", f"{period_s:g} s", "a period from 0.002 to 10 s")
    names = tuple(joint.name for joint in model.joints)
    units = tuple(joint.joint_map.unit for joint in model.joints)
    return RecordingHeader(model.name, names, units, period_s)


def describe_arm(
    model: Model,
    chain: Chain,
    period_s: float,
    zeros: ZeroSource,
    serial_number: str | None = None,
) -> RecordedArm:
    """Return the data of an arm that a recording needs besides its samples.

    An empty serial number means an adapter without one; None means an arm on another machine.

    Raises:
        BadValueError: The period is out of its range.
    """
    header, text = recording_header(model, period_s), ""
    if zeros is ZeroSource.CALIBRATED and serial_number is not None:
        calibration = load_calibration(model.name, serial_number)
        text = dump_calibration(calibration) if calibration else ""
    return RecordedArm(header, model, chain, zeros.value, text)


def record_open_arm(
    arm: OpenArm,
    path: Path | str,
    *,
    duration_s: float | None = None,
    until: Callable[[], bool] | None = None,
    period_s: float = 0.02,
    overwrite: bool = False,
    foxglove_port: int | None = None,
) -> RecordResult:
    """Write the measured joint positions to a file at a fixed rate; torque stays unchanged.

    Ctrl-C ends the recording; the file is then complete.

    Args:
        arm: The arm; it may be on another machine.
        path: A new file: a header, then one line of JSON per sample; or, if it ends in ``.mcap``,
            messages of ROS 2 with goals, link poses and health.
        duration_s: The duration; None records until ``until`` returns True.
        until: Called at each sample; ends the recording by returning True.
        period_s: Time between two samples.
        overwrite: Whether an existing file may be replaced.
        foxglove_port: The port on this machine that serves Foxglove; None serves nothing.

    Raises:
        BadValueError: The file exists, or a number is out of its range.
        FileWriteError: The file cannot be written.
        ServoSilentError: A servo does not answer; the samples so far are kept.
    """
    settings = RecordSettings(path, duration_s, until, period_s, overwrite, foxglove_port)
    if isinstance(arm, Arm):
        return record_arm(arm.context, arm.runner, settings)
    described = describe_arm(arm.model, arm.chain, period_s, arm.zeros)
    return record(lambda: ArmSample.of_states(arm.where().joints), arm.clock, described, settings)


def record_arm(context: ArmContext, runner: MotionRunner, settings: RecordSettings) -> RecordResult:
    """Record an arm on a port of this process; see `record_open_arm`."""
    arm = describe_arm(
        context.model, context.chain, settings.period_s, context.zeros, context.serial_number
    )
    servos = context.servos
    measure = _OwnArm(context, runner) if _is_ros(settings) else None
    measure = measure or (lambda: ArmSample(servos.measure_positions()))
    return record(measure, servos.clock, arm, settings)


class _OwnArm:
    """Sampler of the joint positions at each call, and of the servos' health every second."""

    def __init__(self, context: ArmContext, runner: MotionRunner) -> None:
        self._context, self._runner = context, runner
        self._due_s = -math.inf

    def __call__(self) -> ArmSample:
        servos, now_s = self._context.servos, self._context.now_s()
        goals = servos.goals() if servos.torque.is_on else None
        sample = ArmSample(servos.measure_positions().copy(), goals)
        if now_s < self._due_s:
            return sample
        self._due_s = now_s + _HEALTH_PERIOD_S
        return replace(
            sample, states=self._runner.state().joints, stopped_for=self._runner.stop_text
        )


def record(
    measure: Callable[[], ArmSample], clock: Clock, arm: RecordedArm, settings: RecordSettings
) -> RecordResult:
    """Write the results of ``measure`` to a file at a fixed rate.

    Raises:
        InputError: There is no end, or a number is out of its range.
        InputError: The file exists.
        FileWriteError: The file cannot be written.
        PortError: Foxglove cannot be served at that port.
    """
    check_callable("until", settings.until)
    path, max_s, until, last_s = parse_path(settings.path), settings.max_s, settings.until, 0.0
    period_s = arm.header.period_s
    with ExitStack() as stack:
        writer = _open_writer(path, arm, settings, stack)
        try:
            for elapsed_s in Rate(clock, period_s):
                writer.write_sample(elapsed_s, measure())
                last_s = elapsed_s
                if elapsed_s + period_s > max_s or (until and until()):
                    break
        except KeyboardInterrupt:  # ends the recording; every written sample is complete
            pass
    return RecordResult(path, writer.samples, last_s)


def record_other_process(
    model: Model,
    port: str | None,
    settings: RecordSettings,
) -> RecordResult | None:
    """Record the states of an arm that another program moves; None if no program uses its port.

    Raises:
        IkservoError: That program has ended, or the file cannot be written.
    """
    if query_state(model, port) is None:
        return None

    def measure() -> ArmSample:
        state = query_state(model, port)
        if state is None:
            raise IkservoError(
                "The program that moved the arm has ended.", "The recording up to then is kept."
            )
        return ArmSample.of_states(state.joints)

    serial = serial_number_of(resolve_port(model, port))
    known = calibration_path(model.name, serial).exists()
    zeros = ZeroSource.CALIBRATED if known else ZeroSource.UNKNOWN
    arm = describe_arm(model, model.chain, settings.period_s, zeros, serial)
    return record(measure, RealClock(), arm, settings)


def _is_ros(settings: RecordSettings) -> bool:
    is_mcap = parse_path(settings.path).suffix.lower() == MCAP_SUFFIX
    if settings.foxglove_port is not None and not is_mcap:
        raise BadValueError("The file", str(settings.path), f"a {MCAP_SUFFIX} file for Foxglove")
    return is_mcap


def _open_writer(
    path: Path, arm: RecordedArm, settings: RecordSettings, stack: ExitStack
) -> _SampleWriter:
    if not _is_ros(settings):
        lines = RecordingWriter(path, arm.header, overwrite=settings.overwrite)
        stack.callback(lines.close)
        return lines
    sinks: list[MessageSink] = []
    if settings.foxglove_port is not None:
        sinks.append(FoxgloveServer(settings.foxglove_port, arm.model.title))
        stack.callback(sinks[-1].close)
    urdf, files = arm.urdf(), arm.files()
    files |= {"robot.urdf": urdf} if urdf else {}
    sinks.append(McapFile(path, arm, files, overwrite=settings.overwrite))
    stack.callback(sinks[-1].close)
    return RosRecordingWriter(arm, urdf, sinks)


def read_recording(path: Path | str) -> Recording:
    """Read a recording: JSON lines, or the joint states of an MCAP file.

    An MCAP file that was cut short is read to its last whole second.

    Raises:
        FileFormatError: The file cannot be read, or a part of it is malformed.
    """
    path = parse_path(path)
    require_file(path)
    is_mcap = False
    with suppress(OSError, ValueError), path.open("rb") as file:  # the reader reports the error
        is_mcap = file.read(len(MAGIC)) == MAGIC
    recording = read_mcap(path) if is_mcap else read_json_lines(path)
    for what, values in (("a position", recording.joints), ("a time", recording.times_s)):
        if values.size and not float(np.abs(values).max()) <= _LARGEST:
            found, expected = f"has {what} of {np.abs(values).max():g}", f"at most {_LARGEST:g}"
            raise FileFormatError(path, "", found, expected)
    return recording


_LARGEST = 1e6  # rad, m or s; differences of larger numbers would overflow
