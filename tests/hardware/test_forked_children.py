"""Ports and their locks belong to one process: children neither hold them nor can use them."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path

import pytest

from ikservo.arm.control_server import serve
from ikservo.errors import PortError
from ikservo.hardware import open_port
from ikservo.hardware.transport import acquire_lock

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork")

OWNER = """import os, sys, time
from ikservo.hardware import open_port
port = open_port(sys.argv[1], 1_000_000)
if not os.fork():
    print(os.getpid(), flush=True)
time.sleep(60)
"""


@pytest.fixture(autouse=True)
def own_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)


@pytest.fixture
def short_folder(monkeypatch):
    """Return a folder in which a socket's path is not too long for the system: 107 bytes."""
    monkeypatch.delenv("TMPDIR")
    with tempfile.TemporaryDirectory(dir="/tmp") as folder:
        monkeypatch.setenv("IKSERVO_HOME", folder)
        yield Path(folder)


def in_fork(do):
    """Do something in a forked child; return what it gave, in words."""
    reading, writing = os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # from 3.12 on: there are threads
        child = os.fork()
    if not child:
        with contextlib.suppress(BaseException):
            os.write(writing, str(do()).encode())
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as answer:
        output = answer.read()
    os.waitpid(child, 0)
    return output


def descriptors():
    """Return what this process has open."""
    files = Path("/proc/self/fd").iterdir()
    return {str(file.readlink()) for file in files if file.is_symlink()}


def open_there(port):
    def tell():
        try:
            port.writePort(b"x")
        except PortError as error:
            return error.message
        return "written"

    return tell


def test_a_forked_child_cannot_use_the_port_and_is_told_why(pty_name):
    with open_port(pty_name, 1_000_000) as port:
        assert "opened before this process was forked" in in_fork(open_there(port))
        assert open_there(port)() == "written"


@pytest.mark.skipif(sys.platform != "linux", reason="needs /proc")
def test_a_forked_child_has_neither_the_port_nor_its_lock_open(pty_name, tmp_path):
    lock = lock_name(pty_name, tmp_path)
    with open_port(pty_name, 1_000_000):
        assert lock in descriptors()
        assert lock not in in_fork(descriptors)


def lock_name(device, folder):
    return str(folder / f"ikservo-{device.strip('/').replace('/', '-')}.lock")


@pytest.mark.skipif(sys.platform != "linux", reason="needs /proc")
def test_a_program_that_is_started_inherits_neither(pty_name, tmp_path):
    with open_port(pty_name, 1_000_000):
        listing = subprocess.Popen(["sleep", "60"], close_fds=False)
        links = [link.readlink() for link in Path(f"/proc/{listing.pid}/fd").iterdir()]
        listing.kill()
        listing.wait()
    assert lock_name(pty_name, tmp_path) not in map(str, links)


def test_once_the_owner_is_killed_its_forked_child_does_not_keep_the_port(pty_name):
    owner = subprocess.Popen(
        [sys.executable, "-c", OWNER, pty_name], stdout=subprocess.PIPE, text=True
    )
    child = int(owner.stdout.readline())
    try:
        owner.send_signal(signal.SIGKILL)
        owner.wait()
        with open_port(pty_name, 1_000_000) as port:
            assert port.is_open
    finally:
        os.kill(child, signal.SIGKILL)
        owner.stdout.close()


def test_the_end_of_a_child_leaves_its_parents_lock_in_force(pty_name):
    with open_port(pty_name, 1_000_000) as port:
        in_fork(port.close)
        with pytest.raises(PortError, match="in use by"):
            acquire_lock(pty_name)


def test_a_child_that_closes_the_owners_listener_leaves_the_parent_listening(short_folder):
    listener = serve(str(short_folder / "device"), lambda _: {})
    place = listener._listening.path
    assert in_fork(listener.close) == "None"
    assert place.exists()
    listener.close()
    assert not place.exists()
