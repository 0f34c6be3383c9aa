"""A recording is read completely, or its first wrong line is named."""

import json
import re

import numpy as np
import pytest

from ikservo.apps.teaching.recorder import read_recording
from ikservo.apps.teaching.recording import RecordingHeader, RecordingWriter
from ikservo.errors import FileFormatError, InputError
from ikservo.files.writing import FileWriteError

HEADING = RecordingHeader("so101", ("a", "b"), ("rad", "m"), 0.02)
HEADER = {"schema": "ikservo/recording/1", "arm": "so101", "joints": ["a", "b"],
          "units": ["rad", "m"], "period_s": 0.02}  # fmt: skip


@pytest.fixture
def tape(tmp_path):
    """Write lines, objects as JSON; return the file."""

    def write(*lines):
        path = tmp_path / "wave.jsonl"
        rows = [line if isinstance(line, str) else json.dumps(line) + "\n" for line in lines]
        path.write_text("".join(rows))
        return path

    return write


def sample(t_s, *q):
    return {"t_s": t_s, "q": list(q)}


def test_recording_round_trips(tmp_path):
    with RecordingWriter(tmp_path / "wave.jsonl", HEADING) as recorder:
        recorder.write(0.0, np.array([0.1, 0.02]))
        recorder.write(0.02, np.array([-0.2, 0.03]))
    recording = read_recording(tmp_path / "wave.jsonl")
    assert recording.header == HEADING
    np.testing.assert_array_equal(recording.times_s, [0.0, 0.02])
    np.testing.assert_array_equal(recording.joints, [[0.1, 0.02], [-0.2, 0.03]])


def test_recording_file_has_documented_lines(tmp_path):
    with RecordingWriter(tmp_path / "wave.jsonl", HEADING) as recorder:
        recorder.write(0.0, np.array([0.1234567, 0.0]))
    first, second = (tmp_path / "wave.jsonl").read_text().splitlines()
    assert json.loads(first) == HEADER
    assert second == '{"t_s": 0.0, "q": [0.123457, 0.0]}'


def test_recorded_line_is_complete_once_written(tmp_path):
    recorder = RecordingWriter(tmp_path / "wave.jsonl", HEADING)
    recorder.write(0.0, np.array([0.1, 0.0]))
    assert len(read_recording(tmp_path / "wave.jsonl").times_s) == 1
    recorder.close()


def test_recording_writer_keeps_existing_file(tape):
    path = tape("precious")
    with pytest.raises(InputError, match="exists; use overwrite=True"):
        RecordingWriter(path, HEADING)
    assert path.read_text() == "precious"


def test_recording_writer_overwrites_if_asked(tape):
    path = tape("old")
    RecordingWriter(path, HEADING, overwrite=True).close()
    assert json.loads(path.read_text()) == HEADER


@pytest.mark.parametrize("name", ["no/such/folder/wave.jsonl", "", "a\0b"])
def test_recording_writer_names_path_that_cannot_be_written(tmp_path, name):
    with pytest.raises(FileWriteError):
        RecordingWriter(tmp_path / name, HEADING, overwrite=True)


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ('{"t_s": 0.04, "q": [0.1, ', "line 3: is incomplete"),
        ('{"t_s": 0.04, "q": [0.1, 0.0]}', "line 3: is incomplete"),
        ("\n", "line 3: is not JSON"),
        ("nonsense\n", "line 3: is not JSON"),
        ("[" * 5000 + "\n", "line 3: is not JSON"),
        ("[1, 2]\n", "line 3: is not an object"),
        ('{"t_s": 0.04, "q": [NaN, 0.0]}\n', "line 3: is not JSON"),
        ('{"t_s": 0.04, "q": [Infinity, 0.0]}\n', "line 3: is not JSON"),
        ('{"t_s": 0.04, "q": [1e999, 0.0]}\n', "line 3: has a position that is not a number"),
        ('{"t_s": 0.04, "q": [' + "9" * 400 + ", 0.0]}\n", "has a position that is not a number"),
        (sample(0.04, "0.1", 0.0), "line 3: has a position that is not a number"),
        (sample(0.04, True, 0.0), "line 3: has a position that is not a number"),
        (sample(0.04, None, 0.0), "line 3: has a position that is not a number"),
        (sample(0.04, 0.1), "line 3: has 1 positions"),
        (sample(0.04, 0.1, 0.0, 0.0), "line 3: has 3 positions"),
        ({"t_s": 0.04, "q": {"a": 1}}, "line 3: has 0 positions"),
        (sample(0.0, 0.1, 0.0), "line 3: has t_s = 0"),
        (sample(-1.0, 0.1, 0.0), "line 3: has t_s = -1.0"),
        (sample("soon", 0.1, 0.0), "line 3: has t_s = 'soon'"),
        ({"t_s": 0.04, "q": [0.1, 0.0], "torque": 1}, "line 3: is not a sample"),
        (sample(1e6, 0.1, 0.0), "line 3: has t_s = 1000000.0"),
        ('{"t_s": 0.04, "t_s": 0.05, "q": [0.1, 0.0]}\n', "line 3: is not JSON"),
        ({"time": 0.04, "q": [0.1, 0.0]}, "line 3: is not a sample"),
        ("x" * 20_000 + "\n", "line 3: is too long"),
    ],
)
def test_error_explains_why_recording_line_is_invalid(tape, line, found):
    with pytest.raises(FileFormatError, match=re.escape(found)):
        read_recording(tape(HEADER, sample(0.0, 0.1, 0.0), line))


@pytest.mark.parametrize(
    "change",
    [
        {"schema": "ikservo/recording/2"},
        {"arm": 7},
        {"joints": []},
        {"joints": ["a", "a"]},
        {"joints": ["a", 2]},
        {"joints": "ab"},
        {"units": ["rad"]},
        {"units": ["rad", "deg"]},
        {"period_s": 0},
        {"period_s": "20ms"},
        {"extra": 1},
    ],
)
def test_error_names_line_of_invalid_recording_header(tape, change):
    with pytest.raises(FileFormatError, match="line 1"):
        read_recording(tape({**HEADER, **change}, sample(0.0, 0.1, 0.0)))


@pytest.mark.parametrize("lines", [(), (HEADER,), (sample(0.0, 0.1, 0.0),)])
def test_recording_without_header_or_samples_is_refused(tape, lines):
    with pytest.raises(FileFormatError):
        read_recording(tape(*lines))


def test_error_says_recording_is_missing_or_a_folder(tmp_path):
    with pytest.raises(FileFormatError, match=r"does not exist|is a folder"):
        read_recording(tmp_path / "none.jsonl")
    with pytest.raises(FileFormatError, match=r"does not exist|is a folder"):
        read_recording(tmp_path)
