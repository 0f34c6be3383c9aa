"""A stop reaches every program that can move an arm, even one that is still starting."""

import ast
import errno
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

import ikservo
from ikservo.apps.importing.servo_assignment import _move_and_return
from ikservo.arm.opening import open_bus, open_own_arm
from ikservo.arm.other_process import query_state
from ikservo.cli import main
from ikservo.errors import PortBusyError, RefusedError, StoppedError
from ikservo.hardware.torque import torque_on
from ikservo.maintenance.alarm_recovery import recover
from ikservo.model import load_model
from ikservo.serving import early_stops
from ikservo.serving.control_client import request_stop, request_stop_of, stop_own_programs
from ikservo.serving.control_socket import socket_path
from tests.cli.fixtures_mounted_arm import PORT, connect_arm, write_calibration
from tests.cli.test_recover import overload

PACKAGE = Path(ikservo.__file__).parent
PLANAR = load_model("planar2")


@pytest.fixture(autouse=True)
def _home(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path / "home"))
    monkeypatch.setattr(early_stops, "_forgotten_s", 0.0)


@pytest.fixture
def arm(monkeypatch):
    arm = connect_arm(monkeypatch, "planar2", sign=1)
    write_calibration(arm)
    monkeypatch.setattr(early_stops, "_forgotten_s", 0.0)
    return arm


def torques(arm):
    return [servo.drive.torque_on for servo in arm.line.servos.values()]


CALLS_THAT_MOVE = {"torque_on", "write_goals", "MotionRunner", "check_may_move"}
STOPPABLE = {
    "arm/opening.py": "the bus is a stoppable bus, and the arm takes it over",
    "control/streamed_servos.py": "goals of an arm's control loop",
    "control/stop_requests.py": "the goals of a stop itself",
    "hardware/register_access.py": "`enabling`, which every torque-on passes",
    "hardware/torque.py": "passes `enabling`",
    "apps/calibrating/auto_calibration.py": "takes over the bus of open_torque_off",
    "maintenance/alarm_recovery.py": "on a bus of open_bus; its goals hold joints where they are",
    "apps/importing/servo_assignment.py": "on a stoppable bus; each step is checked",
    "apps/workbench/servo_workbench.py": "on a stoppable bus; each write is checked",
}
STOPPABLE_BUSES = {
    "arm/opening.py",
    "apps/importing/servo_assignment.py",
    "apps/workbench/servo_workbench.py",
}
PLAIN_BUSES = {  # which never switch torque on
    "apps/workbench/id_and_baud_rate.py",
    "hardware/scan.py",
    "apps/workbench/bus_benchmark.py",
    "apps/workbench/doctor.py",
    "apps/workbench/servo_workbench.py",
}


def callers(names):
    """Return the modules that call one of the functions by its name."""
    return {
        str(path.relative_to(PACKAGE))
        for path in PACKAGE.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.Call) and _name_of(node.func) in names
    }


def _name_of(function):
    return getattr(function, "id", getattr(function, "attr", ""))


def test_torque_and_goals_are_written_only_by_stoppable_code():
    assert callers(CALLS_THAT_MOVE) == STOPPABLE.keys()
    assert callers({"stoppable"}) == STOPPABLE_BUSES
    assert callers({"ServoBus"}) == PLAIN_BUSES | STOPPABLE_BUSES


def test_stop_request_reaches_program_with_bus_but_no_arm(arm):
    with open_bus(PLANAR, PORT) as bus:
        assert stop_own_programs().stopped[0].arm == "planar2"
        with pytest.raises(StoppedError):
            torque_on(bus, next(iter(bus.servos)))
    assert torques(arm) == [False, False]


def test_stopped_recover_command_keeps_torque_on(arm):
    with open_bus(PLANAR, PORT) as bus:
        for servo_id in bus.servos:
            torque_on(bus, servo_id)
        overload(arm.line.servos[1])
        request_stop(PORT, "planar2")
        with pytest.raises(StoppedError):
            recover(bus)
    assert torques(arm) == [True, True]


def test_stop_ends_test_motion_of_servo_assignment(arm):
    servo = arm.line.servos[1]
    with open_bus(PLANAR, PORT) as bus:
        moving = _move_and_return(bus, 1)
        start = servo.read("present_position")
        for _ in range(15):
            next(moving)
        assert stop_own_programs().stopped[0].held == ("joint1",)
        before = servo.read("goal_position")
        with pytest.raises(StoppedError):
            next(moving)
    assert 0 < before - start < 60
    assert servo.read("goal_position") == before
    assert torques(arm) == [False, False]


def test_state_request_to_bus_without_arm_says_port_is_busy(arm):
    with open_bus(PLANAR, PORT), pytest.raises(PortBusyError, match="in use"):
        query_state(PLANAR, PORT)


@pytest.mark.parametrize(
    "stop",
    [
        stop_own_programs,
        lambda: request_stop_of("planar2"),
        lambda: request_stop(PORT, "planar2"),
    ],
    ids=["all", "arm", "port"],
)
def test_stop_request_before_port_is_open_is_obeyed(arm, stop):
    stop()
    with open_own_arm(PLANAR, PORT) as machine:
        with pytest.raises(RefusedError, match="before the port was open"):
            machine.move_joints({"joint1": 0.2})
        assert torques(arm) == [False, False]
        machine.acknowledge()
        machine.enable()
    assert torques(arm) == [True, True]


@pytest.mark.parametrize("other", ["so101", "koch"])
def test_stop_of_other_arm_before_port_opening_is_ignored(arm, other):
    request_stop_of(other)
    request_stop("/dev/ttyOTHER", "planar2")
    with open_own_arm(PLANAR, PORT) as machine:
        machine.enable()
    assert torques(arm) == [True, True]


def test_stop_during_command_start_up_ends_command(arm, capsys):
    stop_own_programs()
    words = f"joints joint1=10 --arm planar2 --port {PORT} --yes".split()
    assert (main(words), torques(arm)) == (130, [False, False])
    assert "before the port was open" in capsys.readouterr().err


def test_stop_request_before_close_does_not_stop_reopened_arm(arm):
    with open_own_arm(PLANAR, PORT):
        stop_own_programs()
    with open_own_arm(PLANAR, PORT) as machine:
        assert machine.stop_reason is None


LEAVE_MARK = "from ikservo.serving.early_stops import leave_mark; leave_mark()"
HAS_MARK = """
import sys
from ikservo.serving.early_stops import has_mark
print("ready", flush=True)
sys.stdin.readline()
print(has_mark("/dev/ttyX", "so101"))
"""


@pytest.mark.full
def test_stop_file_stops_programs_started_before_it_only():
    run = [sys.executable, "-c", HAS_MARK]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen(run, **pipes) as earlier:
        assert earlier.stdout.readline() == "ready\n"
        subprocess.run([sys.executable, "-c", LEAVE_MARK], check=True)
        with subprocess.Popen(run, **pipes) as later:
            assert later.communicate("\n")[0] == "ready\nFalse\n"
        assert earlier.communicate("\n")[0] == "True\n"


def test_old_stop_request_files_are_removed(monkeypatch):
    with tempfile.TemporaryDirectory() as home:  # so short that marks are not put elsewhere
        monkeypatch.setenv("IKSERVO_HOME", home)
        early_stops.leave_mark(arm="so101")
        monkeypatch.setattr(early_stops, "_MAX_AGE_S", -1.0)
        assert not early_stops.has_mark("/dev/ttyX", "so101")
        early_stops.leave_mark()
        assert len(list((Path(home) / "run").glob("*.stop"))) == 1


def test_stop_request_file_from_before_reboot_is_ignored(monkeypatch):
    early_stops.leave_mark()
    real = early_stops.time.monotonic
    monkeypatch.setattr(early_stops.time, "monotonic", lambda: real() - 3600.0)
    monkeypatch.setattr(early_stops, "_started_s", lambda: 0.0)
    assert not early_stops.has_mark("/dev/ttyX", "so101")


def test_stop_on_full_disk_leaves_no_partial_request_file(monkeypatch, tmp_path):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))

    def fill_up(path, *_):
        path.touch()
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_text", fill_up)
    early_stops.leave_mark()
    folder = socket_path("any port", "any arm").parent
    assert folder.is_dir()
    assert list(folder.glob(f"*.{os.getpid()}.new")) == []
