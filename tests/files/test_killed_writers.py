"""Programs that save the same file at the same time and are killed meanwhile."""

import os
import random
import signal
import subprocess
import sys
import time

import pytest

from ikservo.apps.cameras.camera_file import SIMULATED, load_camera
from ikservo.apps.lab.health_log import read_records
from ikservo.files.reading import read_text
from ikservo.files.writing import write_atomic

pytestmark = [
    pytest.mark.full,
    pytest.mark.skipif(os.name != "posix", reason="SIGKILL"),
    pytest.mark.timeout(180),
]
KILLS, WRITERS = 12, 3
BEGIN = """
import itertools, sys
from datetime import UTC, datetime
from pathlib import Path
from ikservo.apps.cameras.camera_file import SIMULATED, CameraFile, save_camera
from ikservo.apps.lab.health_log import HealthRecord, append_record
from ikservo.files.writing import write_atomic
path, who = Path(sys.argv[1]), int(sys.argv[2])
day = datetime(2026, 11, 2 + who, tzinfo=UTC)
print("writes", flush=True)
for number in itertools.count():
"""
WRITES = {
    "any file": '    write_atomic(path, f"{who} {number}\\n" * (20_000 * who + 1), keep_old=True)',
    "camera": '    save_camera("so101", SIMULATED, CameraFile(calibrated=day), "cam")',
    "record": (
        '    append_record(path, HealthRecord(written=day, source="monitor", joints=()))\n'
        "    print(number, flush=True)"
    ),
}


def start_writer(path, who, what):
    return subprocess.Popen(
        [sys.executable, "-c", BEGIN + WRITES[what], str(path), str(who)],
        stdout=subprocess.PIPE, text=True, env=dict(os.environ),
    )  # fmt: skip


def kill_writers(path, what, check):
    """Kill writers one after another, and check the file in between.

    Returns:
        The output of each writer.
    """
    dice, printed = random.Random(3), []
    writers = [start_writer(path, who, what) for who in range(WRITERS)]
    try:
        for writer in writers:
            assert writer.stdout.readline() == "writes\n"
        for kill in range(KILLS):
            time.sleep(dice.uniform(0.05, 0.2))  # the moment of a kill is what is tried
            writers[kill % WRITERS].send_signal(signal.SIGKILL)
            printed.append(writers[kill % WRITERS].communicate()[0])
            check()
            writers[kill % WRITERS] = start_writer(path, kill % WRITERS, what)
    finally:
        for writer in writers:
            writer.kill()
            printed.append(writer.communicate()[0])
    return printed


def test_file_written_by_killed_processes_is_never_partial(tmp_path):
    path = tmp_path / "file"
    write_atomic(path, "first\n")

    def check():
        lines = read_text(path, 10**8).splitlines()
        assert len(set(lines)) == 1
        assert lines == ["first"] or len(lines) == 20_000 * int(lines[0][0]) + 1

    kill_writers(path, "any file", check)


def test_camera_file_written_by_killed_processes_is_readable(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    kill_writers(tmp_path, "camera", lambda: load_camera("so101", SIMULATED, "cam"))


def test_health_records_survive_killed_writer_processes(tmp_path):
    path = tmp_path / "health" / "so101.jsonl"
    printed = kill_writers(path, "record", lambda: read_records(path))
    done = sum(len(each.split()) for each in printed) - sum("writes" in each for each in printed)
    records = len(read_records(path))
    assert done <= records <= done + KILLS + WRITERS
