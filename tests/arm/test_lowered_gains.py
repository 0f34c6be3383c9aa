"""Gains that are lowered while a joint swings are put back at every end, even after SIGKILL."""

import os
import signal
import subprocess
import sys

import pytest

import ikservo
from ikservo.apps.workbench.servo_checks import check_servos
from ikservo.control.servo_gains import restore_lowered
from ikservo.errors import RefusedError, StoppedError
from ikservo.files.reading import config_dir
from tests.arm.simulated import line_of, registers, servo_group
from tests.journeys.simulator_process import run_simulator

PAN = 1
GAINS = ("p_gain", "i_gain", "d_gain")
LOWER_AND_WAIT = """
import sys, time, ikservo
arm = ikservo.open_arm("so101", sys.argv[1])
assert arm.context.servos.gains.lower(1) == 4.0
print("lowered", flush=True)
time.sleep(60)
"""


def all_gains(servos):
    return {i: [servo.read(name) for name in GAINS] for i, servo in servos.items()}


def move_swinging_pan(monkeypatch, on_lowered):
    """Move an arm whose pan swings afterwards; return its simulated gains before and after.

    Args:
        monkeypatch: The fixture.
        on_lowered: Called with the arm once the gains of the pan are lowered.
    """
    arm = ikservo.open_arm("so101", port="sim:?seed=154&pose=home")
    servos, gains = line_of(arm).servos, servo_group(arm).gains
    before, lower, lowered = all_gains(servos), gains.lower, list[int]()

    def lower_and_call(servo_id):
        softness = lower(servo_id)
        lowered.append(servo_id)
        assert registers(arm, "p_gain")[servo_id] == 8
        on_lowered(arm)
        return softness

    monkeypatch.setattr(gains, "lower", lower_and_call)
    try:
        return before, arm.move_joints({"shoulder_pan": 0.3}, speed="normal")
    finally:
        assert lowered == [PAN]
        assert all_gains(servos) == before
        arm.close()


def test_gains_of_swinging_joint_are_lowered_said_and_put_back(monkeypatch):
    before, report = move_swinging_pan(monkeypatch, lambda arm: None)
    assert before[PAN] == [32, 0, 32]
    assert "shoulder_pan's gains were lowered while it swung" in report.binding
    assert abs(report.measured_rad["shoulder_pan"] - 0.3) < 0.01


def test_gains_are_put_back_after_stop(monkeypatch):
    with pytest.raises(StoppedError):
        move_swinging_pan(monkeypatch, lambda arm: arm.stop())


@pytest.mark.parametrize("error", [KeyboardInterrupt, RefusedError("broken", "")])
def test_gains_are_put_back_after_error(monkeypatch, error):
    def fail(arm):
        raise error

    with pytest.raises((KeyboardInterrupt, RefusedError)):
        move_swinging_pan(monkeypatch, fail)


def test_gains_are_put_back_before_port_is_closed(monkeypatch):
    with pytest.raises(ikservo.IkservoError):
        move_swinging_pan(monkeypatch, lambda arm: arm.close())


def test_lowering_gains_does_not_wait_for_the_disk(monkeypatch):
    def fail(handle):
        pytest.fail("a motion waits for the disk, which may take longer than a watchdog")

    monkeypatch.setattr("ikservo.control.servo_gains.is_simulator", lambda name: False)
    with ikservo.open_arm("so101", port="sim") as opened:
        gains, folder = servo_group(opened).gains, config_dir() / "tried"
        with monkeypatch.context() as patch:
            patch.setattr(os, "fsync", fail)
            assert gains.lower(PAN) == 4.0
            assert list(folder.iterdir())
            gains.restore(PAN)
        assert not list(folder.iterdir())


@pytest.mark.parametrize("arm", ["so101", "koch"])
def test_lowered_gains_are_quarters_of_former_gains(arm):
    with ikservo.open_arm(arm, port="sim") as opened:
        gains, servo = servo_group(opened).gains, line_of(opened).servos[PAN]
        names = [name for name in servo.table.by_name if name.removeprefix("position_") in GAINS]
        former = {name: servo.read(name) for name in names}
        assert gains.lower(PAN) == pytest.approx(4.0)
        assert {n: servo.read(n) for n in names} == {n: round(f / 4) for n, f in former.items()}
        gains.restore(PAN)
        assert {name: servo.read(name) for name in names} == former


@pytest.fixture
def port(tmp_path, monkeypatch):
    """A simulated arm on a pseudo-terminal, which programs treat as a port with real servos."""
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path / "home"))
    with run_simulator(tmp_path / "line", "so101") as simulator:
        yield str(simulator.port)


def kill_while_lowered(port):
    program = subprocess.Popen(
        [sys.executable, "-c", LOWER_AND_WAIT, port], stdout=subprocess.PIPE, text=True
    )
    assert program.stdout.readline() == "lowered\n"
    program.send_signal(signal.SIGKILL)
    program.communicate()
    assert len(list((config_dir() / "tried").iterdir())) == 1


def read_p_gain(arm):
    bus = servo_group(arm).bus
    return bus.read(PAN, bus.servos[PAN].table.registers["p_gain"], raw=True)


@pytest.mark.full
def test_next_opening_puts_back_gains_of_killed_program(port):
    kill_while_lowered(port)
    with ikservo.open_arm("so101", port) as arm:
        assert read_p_gain(arm) == 32
        warnings = servo_group(arm).warnings
        assert all("put back" in each for each in warnings)
        assert [each.split("put back: ")[1] for each in warnings] == [
            "p_gain 8 → 32.",
            "d_gain 8 → 32.",
        ]
        assert list((config_dir() / "tried").iterdir()) == []
        assert not [each for each in check_servos(servo_group(arm).bus, None)
                    if each.topic == "trial"]  # fmt: skip


@pytest.mark.full
def test_opening_keeps_gain_that_was_changed_since(port):
    with ikservo.open_arm("so101", port) as arm:
        bus, servo = servo_group(arm).bus, servo_group(arm).bus.servos[PAN]
        assert servo_group(arm).gains.lower(PAN) == 4.0
        bus.write_until_power_off(PAN, servo.table.registers["p_gain"], 20)
        (restored,) = restore_lowered(bus)
        assert "d_gain" in restored
        assert read_p_gain(arm) == 20


@pytest.mark.full
def test_gains_stay_if_former_ones_cannot_be_remembered(port, tmp_path, monkeypatch):
    with ikservo.open_arm("so101", port) as arm:
        (tmp_path / "file").write_text("")
        monkeypatch.setenv("IKSERVO_HOME", str(tmp_path / "file"))  # no folder can be made here
        assert servo_group(arm).gains.lower(PAN) == 1.0
        assert read_p_gain(arm) == 32
