"""The program with the port accepts commands from other programs of its user only."""

import os
import socket
import stat
import sys
import tempfile
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from ikservo.arm.control_server import serve
from ikservo.errors import ExitCode, IkservoError, RefusedError, UnknownNameError
from ikservo.serving import control_socket
from ikservo.serving.control_client import ControlCommand, send_command
from ikservo.serving.control_socket import socket_path

posix = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no Unix sockets")


@pytest.fixture(params=[pytest.param("unix", marks=posix), "loopback"])
def kind(request, monkeypatch):
    monkeypatch.setattr(control_socket, "HAS_UNIX_SOCKETS", request.param == "unix")
    return request.param


@pytest.fixture
def device(tmp_path, monkeypatch):
    (tmp_path / "ttyACM0").touch()
    # Addresses of sockets are short, and paths of pytest are not always.
    with tempfile.TemporaryDirectory(prefix="ik-") as short:
        monkeypatch.setenv("IKSERVO_HOME", str(Path(short) / "home"))
        yield str(tmp_path / "ttyACM0")


class Owner:
    """Answers and records requests."""

    def __init__(self, device):
        self.asked = []
        self.listener = serve(device, self.answer)

    def answer(self, request):
        self.asked.append(request.do)
        return {"done": request.do}


@pytest.fixture
def owner(device, kind):
    owner = Owner(device)
    yield owner
    owner.listener.close()


def exchange(device, data):
    """Send a handmade request to the owner; return its reply."""
    connection, _ = control_socket.connect(socket_path(device), 5.0)
    with connection:
        connection.sendall(data)
        connection.shutdown(socket.SHUT_WR)
        return connection.makefile("rb").read()


def test_control_command_is_executed_by_program_owning_port(device, owner):
    assert send_command(device, ControlCommand.STOP) == {"done": "stop"}
    assert owner.asked == ["stop"]


def test_control_command_without_listener_returns_none(device, kind):
    assert send_command(device, ControlCommand.STOP) is None


def test_closed_control_listener_removes_its_socket(device, owner):
    owner.listener.close()
    assert send_command(device, ControlCommand.STOP) is None
    assert not socket_path(device).exists()


def test_program_owning_port_is_found_through_symlink(device, owner, tmp_path):
    link = tmp_path / "by-id-arm"
    link.symlink_to(device)
    assert send_command(str(link), ControlCommand.WHERE) == {"done": "where"}


def test_control_command_for_another_port_finds_no_owner(device, owner, tmp_path):
    assert send_command(str(tmp_path / "ttyACM1"), ControlCommand.WHERE) is None


def test_control_socket_is_open_to_its_user_only(device, owner):
    place = socket_path(device)
    assert stat.S_IMODE(place.parent.stat().st_mode) == 0o700
    assert stat.S_IMODE(place.stat().st_mode) == 0o600


def test_control_socket_folder_falls_back_to_temp_folder(device, monkeypatch):
    for name in ("IKSERVO_HOME", "XDG_RUNTIME_DIR"):
        monkeypatch.delenv(name, raising=False)
    assert socket_path(device).parent.parent == Path(tempfile.gettempdir())  # and no warning


def test_control_socket_folder_is_taken_from_xdg_runtime_dir(device, monkeypatch):
    monkeypatch.delenv("IKSERVO_HOME", raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", "/run/user/7")
    assert socket_path(device).parent == Path("/run/user/7/ikservo")


def test_control_socket_folder_is_made_private(device, kind):
    socket_path(device).parent.mkdir(parents=True)
    socket_path(device).parent.chmod(0o777)
    Owner(device).listener.close()
    assert stat.S_IMODE(socket_path(device).parent.stat().st_mode) == 0o700


def test_control_socket_folder_that_is_a_symlink_is_not_used(device, kind, tmp_path):
    socket_path(device).parent.parent.mkdir()
    socket_path(device).parent.symlink_to(tmp_path, target_is_directory=True)
    assert serve(device, dict) is None


def test_stale_control_socket_of_killed_program_is_replaced(device, kind):
    left = control_socket.open_socket(socket_path(device))
    left.socket.close()  # as the kernel does for a killed process; its file stays
    assert socket_path(device).exists()
    assert send_command(device, ControlCommand.STOP) is None
    owner = Owner(device)
    assert send_command(device, ControlCommand.STOP) == {"done": "stop"}
    owner.listener.close()


def test_second_listener_does_not_replace_running_port_owner(device, owner):
    assert serve(device, dict) is None
    assert send_command(device, ControlCommand.STOP) == {"done": "stop"}


def test_closing_old_owner_keeps_control_socket_of_new_owner(device, kind):
    old = control_socket.open_socket(socket_path(device))
    old.socket.close()
    owner = Owner(device)
    old.close()
    assert send_command(device, ControlCommand.STOP) == {"done": "stop"}
    owner.listener.close()


@pytest.mark.parametrize("data", [b"", b"stop\n", b"{}\n", b"[" * 500 + b"\n", b'{"do":"stop"}\n'])
def test_malformed_control_socket_request_changes_nothing(device, owner, data):
    assert b'"exit_code":2' in exchange(device, data)
    assert owner.asked == []
    assert send_command(device, ControlCommand.WHERE) == {"done": "where"}


def test_oversized_request_to_control_socket_is_rejected(device, owner):
    connection, _ = control_socket.connect(socket_path(device), 5.0)
    with connection, pytest.raises((ConnectionError, TimeoutError)):  # noqa: PT012  # whichever byte
        while True:
            connection.sendall(b" " * 65_536)
    assert owner.asked == []


def test_control_command_over_loopback_needs_secret(device, monkeypatch):
    monkeypatch.setattr(control_socket, "HAS_UNIX_SOCKETS", False)
    owner = Owner(device)
    reply = exchange(device, b'{"schema":"ikservo/owner/1","do":"stop","secret":"guessed"}\n')
    owner.listener.close()
    assert b"belongs to another user" in reply
    assert owner.asked == []


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux says who is on a socket")
def test_control_command_to_program_of_other_user_is_refused(device, monkeypatch):
    owner = Owner(device)
    monkeypatch.setattr(control_socket, "_peer_user", lambda connection: os.getuid() + 1)
    with pytest.raises(IkservoError, match="belongs to another user") as caught:
        send_command(device, ControlCommand.STOP)
    owner.listener.close()
    assert caught.value.exit_code is ExitCode.REFUSED
    assert owner.asked == []


def test_error_of_port_owner_is_raised_in_calling_program(device, kind):
    def refuse(request):
        raise RefusedError("It is locked.", "Unlock it.")

    listener = serve(device, refuse)
    with pytest.raises(IkservoError, match="It is locked") as caught:
        send_command(device, ControlCommand.RELAX)
    listener.close()
    assert (caught.value.hint, caught.value.exit_code) == ("Unlock it.", ExitCode.REFUSED)


def test_error_of_port_owner_keeps_its_class_and_details(device, kind):
    error = UnknownNameError("joint", "elbow", ["elbow_flex"])

    def refuse(request):
        raise error

    listener = serve(device, refuse)
    with pytest.raises(UnknownNameError) as caught:
        send_command(device, ControlCommand.WHERE)
    listener.close()
    assert str(caught.value) == str(error)
    assert (caught.value.name, list(caught.value.known)) == ("elbow", ["elbow_flex"])


def test_crashing_command_does_not_end_program_owning_port(device, kind):
    replies = iter([ZeroDivisionError("oops"), None])

    def stumble(request):
        problem = next(replies)
        if problem:
            raise problem
        return {"done": "at last"}

    listener = serve(device, stumble)
    with pytest.raises(IkservoError, match="ZeroDivisionError: oops"):
        send_command(device, ControlCommand.WHERE)
    assert send_command(device, ControlCommand.WHERE) == {"done": "at last"}
    listener.close()


def test_silent_clients_do_not_delay_other_clients(device, owner):
    idle = [control_socket.connect(socket_path(device), 5.0)[0] for _ in range(10)]
    assert send_command(device, ControlCommand.STOP) == {"done": "stop"}
    for connection in idle:
        connection.close()


def test_stop_is_answered_despite_40_silent_clients(device, owner):
    silent = [control_socket.connect(socket_path(device), 5.0)[0] for _ in range(40)]
    assert send_command(device, ControlCommand.STOP) == {"done": "stop"}
    for connection in silent:
        connection.close()


def test_stop_is_answered_while_clients_wait_for_state(device, kind):
    entered, leave = threading.Semaphore(0), threading.Event()

    def wait_for_state(request):
        if request.do is not ControlCommand.WHERE:
            return {"done": request.do.value}
        entered.release()
        leave.wait(20)
        return {}

    listener = serve(device, wait_for_state)
    with ThreadPoolExecutor(12) as pool:
        calls = [pool.submit(send_command, device, ControlCommand.WHERE, 20.0) for _ in range(12)]
        for _ in calls:
            assert entered.acquire(timeout=20)
        with pytest.raises(RefusedError, match="Too many programs are asking for the state"):
            send_command(device, ControlCommand.WHERE)
        for command in (ControlCommand.WHO, ControlCommand.STOP, ControlCommand.RELAX):
            assert send_command(device, command) == {"done": command.value}
        leave.set()
        assert [call.result() for call in calls] == [{}] * 12
    listener.close()


def test_control_socket_works_with_long_home_path(device, monkeypatch, tmp_path):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path / ("deep" * 30)))
    monkeypatch.setenv("TMPDIR", "/tmp")
    monkeypatch.setattr("tempfile.tempdir", None)
    owner = Owner(device)
    assert send_command(device, ControlCommand.STOP) == {"done": "stop"}
    owner.listener.close()


def test_device_with_unusual_name_has_control_socket_path(tmp_path):
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    names = (str(tmp_path / "loop"), "/dev/m\udcfcller")
    assert len({socket_path(name) for name in names}) == 2
