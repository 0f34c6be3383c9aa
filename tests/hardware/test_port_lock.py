"""One process per port, whatever the name; a second one is told who has it."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys

import pytest

from ikservo.errors import PortBusyError
from ikservo.hardware import open_port
from ikservo.hardware.port_lock import acquire_lock

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows opens a port only once")

HOLD = """import sys
from ikservo.hardware.port_lock import acquire_lock
lock = acquire_lock(sys.argv[1])
print("held", flush=True)
sys.stdin.read()
"""


@pytest.fixture(autouse=True)
def own_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)


@pytest.fixture
def holder(pty_name):
    """Let another process hold a port."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, pty_name],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout.readline() == "held\n"
    yield process
    process.communicate("")


def test_second_open_names_process_that_holds_port(pty_name, holder):
    with pytest.raises(PortBusyError, match=rf"in use by python.* \(process {holder.pid}\)"):
        open_port(pty_name, 1_000_000)


def test_symbolic_link_to_port_uses_same_port_lock(pty_name, holder, tmp_path):
    link = tmp_path / "by-id-arm"
    link.symlink_to(pty_name)
    with pytest.raises(PortBusyError, match="in use by"):
        open_port(str(link), 1_000_000)


def test_port_lock_is_released_when_its_process_dies(pty_name, holder):
    holder.send_signal(signal.SIGKILL)
    holder.wait()
    with open_port(pty_name, 1_000_000) as port:
        assert port.is_open


def test_closing_port_releases_its_lock(pty_name):
    open_port(pty_name, 1_000_000).close()
    with acquire_lock(pty_name):
        pass


def test_port_that_cannot_be_opened_leaves_no_lock(tmp_path):
    missing = str(tmp_path / "ttyMISSING")
    with pytest.raises(OSError, match="Cannot open"):
        open_port(missing, 1_000_000)
    with acquire_lock(missing):
        pass


def start(pty_name):
    return subprocess.Popen(
        [sys.executable, "-c", HOLD, pty_name],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )


LONG = pytest.param(100, marks=[pytest.mark.campaign, pytest.mark.timeout(3600)])


@pytest.mark.full
@pytest.mark.parametrize("races", [1, LONG])
def test_only_one_of_racing_processes_gets_port_lock(pty_name, races):
    chance = random.Random(3)
    for race in range(races):
        racers = [start(pty_name) for _ in range(chance.randint(2, 8) if race else 4)]
        winners = [racer for racer in racers if racer.stdout.readline() == "held\n"]
        assert len(winners) == 1, f"race {race}"
        winners[0].send_signal(signal.SIGKILL)
        for racer in racers:
            racer.communicate("")
        with acquire_lock(pty_name):
            pass


def test_port_lock_file_that_is_a_link_is_not_followed(pty_name, tmp_path):
    target = tmp_path / "precious"
    target.write_text("keep me")
    name = os.path.realpath(pty_name).replace("/", "-").strip("-")
    (tmp_path / f"ikservo-{name}.lock").symlink_to(target)
    with acquire_lock(pty_name):
        assert target.read_text() == "keep me"


def test_port_lock_owner_with_undecodable_name_is_reported(pty_name, monkeypatch):
    monkeypatch.setattr(sys, "orig_argv", ["python", "m\udcfcller.py"])
    with acquire_lock(pty_name), pytest.raises(PortBusyError, match=r"m\?ller\.py"):
        acquire_lock(pty_name)
