"""Recordings as MCAP files with ROS 2 messages: joints, goals, link poses, health, description.

The file is flushed every second of the recording, so that an interrupted recording can be read up
to its last flush.

Source: the MCAP specification, https://mcap.dev/spec, with the profile ``ros2``.
"""

from __future__ import annotations

import json
import platform
import time
from array import array
from collections.abc import Generator, Iterable, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from ikservo.apps.teaching.mcap_records import MAGIC, import_mcap, read_records
from ikservo.apps.teaching.recording import (
    MAX_JOINTS,
    MAX_SAMPLES,
    MAX_SECONDS,
    SCHEMA,
    ArmSample,
    Recording,
    RecordingFile,
    RecordingHeader,
    check_header,
)
from ikservo.errors import FileFormatError, IkservoError
from ikservo.files.reading import parse_json, read_text
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Matrix
from ikservo.model import Model
from ikservo.model.model_loading import description_text
from ikservo.ros_messages.arm_messages import JOINT_STATES, ArmMessages, RosMessage, Topic
from ikservo.ros_messages.message_types import decode, definition

if TYPE_CHECKING:
    from mcap.writer import Writer

__all__ = ["CALIBRATION_FILE", "MAGIC", "McapFile", "MessageSink", "RecordedArm",
           "RosRecordingWriter", "read_attachment", "read_mcap"]  # fmt: skip


CALIBRATION_FILE = "calibration.toml"
"""Name of the attachment with the arm's calibration."""

_METADATA = "ikservo"
_FLUSH_PERIOD_S = 1.0
_MAX_FILE_BYTES = 1024 * 1024
_NS = 1_000_000_000
_LATEST_NS = 2**63 - 1
_MAX_LAYOUTS = 1000


class MessageSink(Protocol):
    """Receiver of the messages of a recording."""

    def publish(self, message: RosMessage, /) -> None:
        """Receive one message."""
        ...

    def flush(self) -> None:
        """Flush all received messages to the operating system."""
        ...

    def close(self) -> None:
        """Close the sink."""
        ...


@dataclass(frozen=True, slots=True)
class RecordedArm:
    """The data of a recording except its samples.

    Attributes:
        header: The description of the columns.
        model: The arm.
        chain: The calibrated chain of the arm.
        zeros: The source of the joint zeros.
        calibration: The text of the calibration file; empty if there is none.
    """

    header: RecordingHeader
    model: Model
    chain: Chain
    zeros: str
    calibration: str = ""

    def urdf(self) -> str:
        """Return the description of the arm; empty if it is not a URDF.

        Raises:
            FileFormatError: A file has changed since it was loaded, and can no longer be read.
        """
        return description_text(self.model)

    def files(self) -> dict[str, str]:
        """Return the texts of all attachments by name, except the description.

        Raises:
            FileFormatError: A file has changed since it was loaded, and can no longer be read.
        """
        path, texts = self.model.path, dict[str, str]()
        if path.suffix == ".toml":
            texts["arm.toml"] = read_text(path, _MAX_FILE_BYTES)
        if self.calibration:
            texts[CALIBRATION_FILE] = self.calibration
        return texts

    def metadata(self) -> dict[str, str]:
        """Return the header and the software versions of the recording as MCAP metadata."""
        header = self.header
        return {
            "schema": SCHEMA,
            "arm": header.arm,
            "joints": json.dumps(header.joints),
            "units": json.dumps(header.units),
            "period_s": json.dumps(header.period_s),
            "zeros": self.zeros,
            "ikservo": version("ikservo"),
            "mcap": version("mcap"),
            "rosbags": version("rosbags"),
            "python": platform.python_version(),
            "system": platform.platform(),
        }


class McapFile:
    """Writer of messages to an MCAP file.

    Args:
        path: A new file.
        arm: The arm.
        files: The texts of the attachments, by name.
        overwrite: Whether an existing file may be replaced.

    Raises:
        InputError: The file exists and ``overwrite`` is false.
        FileWriteError: The file cannot be written.
        IkservoError: The extra ``record`` is not installed.
    """

    def __init__(
        self, path: Path, arm: RecordedArm, files: Mapping[str, str], *, overwrite: bool
    ) -> None:
        module = import_mcap()
        metadata = arm.metadata()
        self.channels = dict[Topic, int]()
        self._target = RecordingFile(path, overwrite=overwrite)
        self._writer: Writer = module.Writer(cast("IO[bytes]", _WholeWrites(self._target.file)))
        with self._target.removing_on_error(), self._naming_the_file():
            self._writer.start("ros2", f"ikservo {version('ikservo')}")
            self._writer.add_metadata(_METADATA, metadata)
            for name, text in files.items():
                media = "application/toml" if name.endswith(".toml") else "application/xml"
                now_ns = time.time_ns()
                self._writer.add_attachment(now_ns, now_ns, name, media, text.encode())

    def publish(self, message: RosMessage) -> None:
        """Write a message.

        Raises:
            FileWriteError: The disk is full or not writable.
        """
        with self._naming_the_file():
            if message.topic not in self.channels:
                text = definition(message.topic.kind).encode()
                schema = self._writer.register_schema(message.topic.kind, "ros2msg", text)
                self.channels[message.topic] = self._writer.register_channel(
                    message.topic.name, "cdr", schema, {"offered_qos_profiles": ""}
                )
            channel = self.channels[message.topic]
            self._writer.add_message(channel, message.time_ns, message.data, message.time_ns)

    def flush(self) -> None:
        """Write all buffered messages, as a chunk that can be read independently."""
        with self._naming_the_file():
            self._writer.flush()

    def close(self) -> None:
        """Write the index and close the file, which then replaces any file of the same name.

        Raises:
            FileWriteError: The disk is full or not writable.
        """
        try:
            with self._naming_the_file():
                self._writer.finish()
        finally:
            self._target.finish()

    @contextmanager
    def _naming_the_file(self) -> Generator[None]:
        """Convert a system error to an error that names the file."""
        try:
            yield
        except OSError as error:
            if isinstance(error, IkservoError):
                raise
            raise self._target.failed(error) from error


class _WholeWrites:
    """An unbuffered file whose write() repeats short writes until all bytes are written."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file, self.tell, self.flush = file, file.tell, file.flush

    def write(self, data: bytes) -> int:
        """Write all bytes.

        Raises:
            OSError: The disk is full or not writable.
        """
        left = memoryview(data)
        while left:
            left = left[self._file.write(left) :]
        return len(data)


class RosRecordingWriter:
    """Converter from samples to messages, which it passes to sinks.

    Attributes:
        samples: The number of samples that were written.
    """

    def __init__(self, arm: RecordedArm, urdf: str, sinks: Iterable[MessageSink]) -> None:
        self.samples = 0
        self._names, self._period_s = arm.header.joints, arm.header.period_s
        self._messages, self._sinks = ArmMessages(arm.model, arm.chain), tuple(sinks)
        self._start_ns: int | None = None
        self._flushed_s = 0.0
        if urdf:
            self._publish(self._messages.description(time.time_ns(), urdf))
        still = dict.fromkeys(self._names, 0.0)
        self._messages.transforms(0, still)  # the first messages are slow: they generate code
        self._messages.joint_states(0, still)

    def write_sample(self, time_s: float, sample: ArmSample) -> None:
        """Write the sample at one instant, in seconds since the first sample.

        Raises:
            FileWriteError: The disk is full or not writable.
        """
        if self._start_ns is None:
            self._start_ns = time.time_ns() - round(time_s * _NS)
        time_ns = self._start_ns + round(time_s * _NS)
        positions = self._by_name(sample.positions)
        self._publish(self._messages.joint_states(time_ns, positions))
        if sample.goals is not None:
            self._publish(self._messages.goal(time_ns, self._by_name(sample.goals)))
        self._publish(self._messages.transforms(time_ns, positions))
        if sample.states:
            self._publish(self._messages.diagnostics(time_ns, sample.states, sample.stopped_for))
        self.samples += 1
        if self.samples == 1 or time_s + self._period_s > self._flushed_s + _FLUSH_PERIOD_S:
            self._flushed_s = time_s
            for sink in self._sinks:
                sink.flush()

    def _by_name(self, values: Any) -> dict[str, float]:  # noqa: ANN401  # (n,)
        return dict(zip(self._names, values.tolist(), strict=True))

    def _publish(self, message: RosMessage) -> None:
        for sink in self._sinks:
            sink.publish(message)


# reading


def read_attachment(path: Path, name: str) -> str | None:
    """Read the text of an attachment of an MCAP file; None if it is missing.

    Raises:
        FileFormatError: The file cannot be read, or the attachment is not text.
    """
    from mcap.records import Attachment  # noqa: PLC0415

    for record in read_records(path):
        if isinstance(record, Attachment) and record.name == name:
            try:
                return record.data.decode()
            except UnicodeDecodeError:
                raise FileFormatError(path, name, "is not text in UTF-8") from None
    return None


read_calibration_text = partial(read_attachment, name=CALIBRATION_FILE)
"""Read the calibration that is attached to a recording; None if it has none."""


def read_mcap(path: Path) -> Recording:
    """Read the joint positions from an MCAP file that ``ikservo record`` or ROS 2 wrote.

    Raises:
        FileFormatError: The file cannot be read, or has no joint states.
    """
    reader = _JointStateReader(path)
    for record in read_records(path, reader.channels):
        reader.take(record)
    return reader.recording()


class _JointStateReader:
    """Collector of joint states from the records of a file.

    Joints that are published separately are merged: samples begin when all of them are known.
    Samples are sorted by time stamp, because messages from several publishers arrive in any order.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._header: RecordingHeader | None = None
        self._schemas: dict[int, str] = {}
        self.channels: set[int] = set()
        # Numbers per message, with the joint names in one of a few layouts, because a dictionary
        # for each of two million messages would take gigabytes.
        self._layouts: dict[tuple[str, ...], int] = {}
        self._times_ns, self._layout_of, self._positions = array("q"), array("l"), array("d")

    def take(self, record: object) -> None:
        from mcap.records import Channel, Message, Metadata, Schema  # noqa: PLC0415

        match record:
            case Metadata() if record.name == _METADATA:
                self._header = self._read_header(record.metadata)
            case Schema():
                self._schemas[record.id] = record.name
            case Channel() if self._has_joints(record):
                self.channels.add(record.id)
            case Message() if record.channel_id in self.channels:
                self._add(record.log_time, record.data)
            case _:
                pass

    def recording(self) -> Recording:
        """Return the collected recording.

        Raises:
            FileFormatError: There are no samples.
        """
        times_ns, rows = np.unique(np.array(self._times_ns, dtype=np.int64), return_inverse=True)
        names = self._header.joints if self._header else tuple(self._names())
        table = self._table(names, rows, len(times_ns))
        complete = np.isfinite(table).all(axis=1)
        if not complete.any():
            raise FileFormatError(
                self._path, "", "has no sample", f"{JOINT_STATES.name} of every joint"
            )
        times_s = (times_ns - times_ns[int(np.argmax(complete))]) / _NS
        if times_s[-1] > MAX_SECONDS:
            raise FileFormatError(
                self._path, "the last sample", "is too late",
                f"at most {MAX_SECONDS:.0f} s of samples",
            )  # fmt: skip
        header = self._header
        if header is None:  # another program made the recording
            period_s = float(np.median(np.diff(times_s))) if len(times_s) > 1 else 1.0
            header = RecordingHeader("", names, ("rad_or_m",) * len(names), period_s)
        return Recording(header, times_s[complete], table[complete], first_line=None)

    def _names(self) -> dict[str, None]:
        """Return the names of all joints in the order of their first messages."""
        return dict.fromkeys(name for layout in self._layouts for name in layout)

    def _table(self, names: tuple[str, ...], rows: NDArray[np.intp], count: int) -> Matrix:
        """Compute the positions (count, n); a joint missing from a row keeps its position."""
        table = np.full((count, len(names)), np.nan)
        widths = np.array([len(layout) for layout in self._layouts])
        layout_of, values = np.array(self._layout_of), np.array(self._positions)
        starts = np.cumsum(widths[layout_of]) - widths[layout_of] if len(layout_of) else layout_of
        for layout, number in self._layouts.items():
            own = np.flatnonzero(layout_of == number)
            for at, name in enumerate(layout):
                if name in names:
                    table[rows[own], names.index(name)] = values[starts[own] + at]
        known = np.where(np.isfinite(table), np.arange(count)[:, None], 0)
        return np.take_along_axis(table, np.maximum.accumulate(known), axis=0)

    def _has_joints(self, channel: Any) -> bool:  # noqa: ANN401  # a record
        own = channel.topic == JOINT_STATES.name and channel.message_encoding == "cdr"
        return own and self._schemas.get(channel.schema_id) == JOINT_STATES.kind

    def _read_header(self, metadata: Mapping[str, str]) -> RecordingHeader:
        where = f"the metadata {_METADATA}"
        if metadata.get("schema") != SCHEMA:
            raise FileFormatError(self._path, where, "has another version", f'"{SCHEMA}"')
        try:
            row = {key: parse_json(metadata[key]) for key in ("joints", "units", "period_s")}
        except (KeyError, ValueError, RecursionError):
            raise FileFormatError(
                self._path, where, "is malformed", "the fields joints, units and period_s"
            ) from None
        return check_header(self._path, where, {**row, "arm": metadata.get("arm")})

    def _add(self, log_time_ns: int, data: bytes) -> None:
        where = f"sample {len(self._times_ns) + 1}"
        try:
            message = decode(JOINT_STATES.kind, data)
        except IkservoError as error:
            raise FileFormatError(self._path, where, f"is malformed ({error.message})") from None
        if len(message.name) > MAX_JOINTS:
            found = f"has {len(message.name):,} joints"
            raise FileFormatError(self._path, where, found, f"at most {MAX_JOINTS} joints")
        if len(message.name) != len(message.position) or not np.isfinite(message.position).all():
            raise FileFormatError(
                self._path, where, "has a wrong number of positions", "one finite number per joint"
            )
        stamp = message.header.stamp
        time_ns = stamp.sec * _NS + stamp.nanosec or log_time_ns
        if time_ns > _LATEST_NS:
            raise FileFormatError(self._path, where, "is too late", "a time in this century")
        names = tuple(message.name)
        if names not in self._layouts:
            self._layouts[names] = len(self._layouts)
            if len(self._names()) > MAX_JOINTS or len(self._layouts) > _MAX_LAYOUTS:
                found = f"has other joints than {len(self._layouts) - 1} earlier messages"
                expected = f"at most {MAX_JOINTS} joints, in one order"
                raise FileFormatError(self._path, where, found, expected)
        self._layout_of.append(self._layouts[names])
        self._times_ns.append(time_ns)
        self._positions.extend(message.position)
        if len(self._times_ns) > MAX_SAMPLES:
            raise FileFormatError(
                self._path, where, "is one sample too many", f"at most {MAX_SAMPLES} samples"
            )
