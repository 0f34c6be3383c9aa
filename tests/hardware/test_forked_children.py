"""Ports and their locks belong to one process: forked children cannot hold or use them."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import threading
import warnings
from pathlib import Path

import pytest

import ikservo
from ikservo.arm.control_server import serve
from ikservo.errors import PortError
from ikservo.hardware import ServoBus, ServoSpec, open_port
from ikservo.hardware.port_lock import acquire_lock
from ikservo.registers import STS3215, RegisterName

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork")

OWNER = """import os, sys, time
from ikservo.hardware import ServoBus, ServoSpec, open_port
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
    """Run a function in a forked child; return its result as text."""
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
    """Return the open file descriptors of this process."""
    files = Path("/proc/self/fd").iterdir()
    return {str(file.readlink()) for file in files if file.is_symlink()}


def message_of(use):
    try:
        use()
    except PortError as error:
        return error.message
    return "done"


USES = {
    "write": lambda port: port.writePort(b"x"),
    "read": lambda port: port.read_until(1, 0.0),
    "clear": lambda port: port.clearPort(),
    "count": lambda port: port.getBytesAvailable(),
    "rate": lambda port: port.setBaudRate(500_000),
}
SIM = f"sim:{Path(ikservo.__file__).parent.parent / 'configs/so101/arm.toml'}"
FORKED = "opened by the parent process before the fork"


@pytest.mark.parametrize("use", USES.values(), ids=USES)
@pytest.mark.parametrize("name", ["pty", "sim"])
def test_forked_child_that_uses_port_gets_clear_error(pty_name, name, use):
    with open_port(pty_name if name == "pty" else SIM, 1_000_000) as port:
        assert FORKED in in_fork(lambda: message_of(lambda: use(port)))
        assert message_of(lambda: use(port)) == "done"


def test_child_forked_during_bus_access_fails_at_once():
    servos = [ServoSpec(1, STS3215, "shoulder_pan")]
    held, done = threading.Event(), threading.Event()
    with open_port(SIM, 1_000_000) as port:
        bus = ServoBus(port, servos)

        def use_port():
            with port.exchange():
                port.is_using = True
                held.set()
                done.wait(60)

        def try_all():
            torque = RegisterName.TORQUE_ENABLE
            uses = (
                lambda: bus.read(1, torque, raw=True),
                lambda: bus.write(1, torque, 0, raw=True),
                lambda: bus.sync_read([1], torque, raw=True),
                lambda: bus.sync_write(torque, {1: 0}, raw=True),
            )
            answers = [message_of(use) for use in uses]
            port.close()
            return answers

        thread = threading.Thread(target=use_port)
        thread.start()
        assert held.wait(60)
        try:
            assert in_fork(try_all).count(FORKED) == 4
        finally:
            done.set()
            thread.join()
        assert bus.read(1, RegisterName.TORQUE_ENABLE, raw=True) == 0


def test_forked_child_opens_port_while_parent_opens_another(pty_name, monkeypatch):
    opening, done = threading.Event(), threading.Event()

    def open_slowly(*_):
        opening.set()
        done.wait(60)
        raise PortError("too late")

    with monkeypatch.context() as patch:
        patch.setattr("ikservo.hardware.port.open_transport", open_slowly)
        slow = lambda: message_of(lambda: open_port("/dev/other", 1_000_000, "so101", [1]))  # noqa: E731
        thread = threading.Thread(target=slow)
        thread.start()
        assert opening.wait(60)
    try:
        own = in_fork(lambda: message_of(lambda: open_port(pty_name, 1_000_000, "so101", [1])))
    finally:
        done.set()
        thread.join()
    assert own == "done"


@pytest.mark.skipif(sys.platform != "linux", reason="needs /proc")
def test_forked_child_holds_no_port_lock(pty_name, tmp_path):
    lock = lock_name(pty_name, tmp_path)
    with open_port(pty_name, 1_000_000):
        assert lock in descriptors()
        assert lock not in in_fork(descriptors)


def lock_name(device, folder):
    return str(folder / f"ikservo-{device.strip('/').replace('/', '-')}.lock")


@pytest.mark.skipif(sys.platform != "linux", reason="needs /proc")
def test_subprocess_does_not_inherit_port_lock(pty_name, tmp_path):
    with open_port(pty_name, 1_000_000):
        command = ["ls", "-l", "/proc/self/fd"]
        listing = subprocess.run(
            command, close_fds=False, capture_output=True, text=True, check=True
        ).stdout
    assert "-> pipe:" in listing
    assert lock_name(pty_name, tmp_path) not in listing


def test_forked_child_of_killed_program_does_not_keep_port(pty_name):
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


def test_end_of_forked_child_keeps_port_lock_of_parent(pty_name):
    with open_port(pty_name, 1_000_000) as port:
        in_fork(port.close)
        with pytest.raises(PortError, match="in use by"):
            acquire_lock(pty_name)


def test_listener_closed_in_forked_child_stays_open_in_parent(short_folder):
    listener = serve(str(short_folder / "device"), lambda _: {})
    place = listener._listening.path
    assert in_fork(listener.close) == "None"
    assert place.exists()
    listener.close()
    assert not place.exists()
