"""Values of wrong types and numbers that overflow are refused with an error of ikservo."""

import inspect
import math
import warnings

import numpy as np
import pytest

import ikservo
from ikservo.apps.teaching.recorder import read_recording
from ikservo.apps.teaching.recording import RecordingHeader, RecordingWriter
from ikservo.errors import FileFormatError, IkservoError

HOSTILE = [[], {}, None, b"x", math.nan, -math.inf, 1e308, 10**400, "", "\0", object(), np.zeros(3)]


@pytest.fixture(scope="module")
def arm():
    with ikservo.open_arm("so101", "sim:?pose=home") as arm:
        arm.scene.add("sphere", "ball", centre_m=(0.3, 0.2, 0.1), radius_m=0.02)
        yield arm


def methods(owner):
    """Yield each public method whose first parameter is positional, and how many it needs."""
    for name, method in inspect.getmembers(owner, inspect.ismethod):
        needed = [
            each
            for each in inspect.signature(method).parameters.values()
            if each.default is each.empty and each.kind in (0, 1)
        ]
        if not name.startswith("_") and needed:
            yield name, method, len(needed)


@pytest.mark.parametrize("value", HOSTILE, ids=lambda value: repr(value)[:12])
def test_scene_and_camera_refuse_hostile_values(arm, value):
    before = arm.scene.names
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for owner in (arm.scene, arm.camera):
            for name, method, count in methods(owner):
                if name not in ("take_over", "is_of_same_arm"):
                    with pytest.raises(IkservoError):
                        method(*count * [value])
        if value is not None:
            with pytest.raises(IkservoError):
                arm.scene.add("box", value, centre_m=(0, 0, 1), size_m=(1, 1, value))
            with pytest.raises(IkservoError):
                arm.scene.change("ball", centre_m=(0.3, 0.2, value))
    assert arm.scene.names == before


@pytest.mark.parametrize("value", HOSTILE, ids=lambda value: repr(value)[:12])
def test_files_and_ports_refuse_hostile_values(value):
    for read in (ikservo.read_drawing, read_recording, ikservo.load_model):
        with pytest.raises(IkservoError):
            read(value)
    if value is not None and not (isinstance(value, str) and value == ""):
        with pytest.raises(IkservoError):
            ikservo.open_arm("so101", value)


@pytest.mark.parametrize("number", ["1e308", "-1e300"])
def test_recording_with_overflowing_number_is_refused(tmp_path, number):
    path = tmp_path / "a.jsonl"
    header = RecordingHeader("so101", ("a",), ("rad",), 0.02)
    with RecordingWriter(path, header) as writer:
        writer.write(0.0, np.zeros(1))
        writer.write(0.02, np.full(1, 123456.5))
    read_recording(path)
    path.write_text(path.read_text().replace("123456.5", number))
    with pytest.raises(FileFormatError, match=r"has a position of 1e\+30"):
        read_recording(path)
