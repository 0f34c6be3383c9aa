"""Two programs that change one file at the same time lose nothing of each other's changes."""

import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from datetime import UTC, datetime

import pytest

from ikservo.calibration import calibration_file
from ikservo.calibration.calibration_file import (
    backup_path,
    dump_calibration,
    read_calibration,
    undo_calibration,
)
from ikservo.files import writing
from ikservo.files.writing import FileWriteError
from ikservo.hardware import port_names
from ikservo.model import load_model
from ikservo.planning.poses import PoseLibrary
from tests.calibration.records import calibration_of, joint

WAIT_S = 0.5


@pytest.fixture
def at_once(monkeypatch):
    """Return a function that runs others in parallel, which wait for each other after reading."""

    def run(reading, *actions):
        barrier = threading.Barrier(len(actions))

        def read(*arguments):
            found = original(*arguments)
            with suppress(threading.BrokenBarrierError):  # only one may read at a time
                barrier.wait(WAIT_S)
            return found

        place, name = reading
        original = getattr(place, name)
        monkeypatch.setattr(place, name, read)
        with ThreadPoolExecutor(len(actions)) as pool:
            for each in [pool.submit(action) for action in actions]:
                each.result()
        monkeypatch.setattr(place, name, original)

    return run


def test_simultaneous_calibration_undos_keep_both_versions(at_once, tmp_path):
    path, calibration = tmp_path / "arm.toml", calibration_of(joint())
    earlier = calibration.model_copy(update={"written": datetime(2026, 1, 1, tzinfo=UTC)})
    path.write_text(dump_calibration(calibration))
    backup_path(path).write_text(dump_calibration(earlier))
    at_once((calibration_file, "read_calibration"), *[lambda: undo_calibration(path)] * 2)
    kept = {read_calibration(each).written for each in (path, backup_path(path))}
    assert kept == {calibration.written, earlier.written}


def test_poses_taught_by_two_programs_at_once_are_both_kept(at_once, tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    model = load_model("planar2")
    positions = model.pose("home")

    def teach(name):
        PoseLibrary(model, "").save(name, positions)

    at_once((PoseLibrary, "user_poses"), lambda: teach("cup"), lambda: teach("plate"))
    assert {*PoseLibrary(model, "").user_poses()} == {"cup", "plate"}


def test_adapters_stored_by_two_programs_at_once_are_kept(at_once, tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    remember = port_names.remember_serial_number
    at_once((port_names, "_read_serial_numbers"),
            lambda: remember("so101", "A1"), lambda: remember("koch", "B2"))  # fmt: skip
    assert [port_names.remembered_serial_number(arm) for arm in ("so101", "koch")] == ["A1", "B2"]


def test_file_locked_by_another_program_is_reported(tmp_path, monkeypatch):
    monkeypatch.setattr(writing, "_LONGEST_LOCK_S", 0.05)
    path = tmp_path / "arm.toml"
    busy = pytest.raises(FileWriteError, match="another program is changing it")
    with writing.exclusive_access(path), busy, writing.exclusive_access(path):
        pass
    with writing.exclusive_access(path):
        pass  # it is free again
