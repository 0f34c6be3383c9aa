"""``calibrate --auto`` killed as a process: the changed registers are reported and restored."""

import contextlib
import os
import signal
import subprocess
import sys

import pytest

from ikservo.apps.workbench.servo_workbench import ServoLine, plan_writes, write_registers
from ikservo.arm.opening import open_bus
from ikservo.clock import RealClock
from ikservo.errors import BusError
from ikservo.files.reading import config_dir
from ikservo.model import load_model
from tests.cli.test_over_a_pty import IKSERVO, served

pytestmark = [
    pytest.mark.full,
    pytest.mark.skipif(sys.platform == "win32", reason="Windows has no ptys"),
    pytest.mark.timeout(300),
]
EEPROM = ("operating_mode", "homing_offset", "min_position_limit", "max_position_limit")
# A moment is a line that the calibration prints, or the journal of the first write to a servo.
MOMENTS = ("first write", "Torque is on", "shoulder_pan moves")
TRIES = 12  # a busy computer keeps the simulator waiting for longer than a driver waits


def read_eeprom(arm, port):
    with open_bus(load_model(arm), port) as bus:
        return {
            (servo, name): read_in_time(bus, servo, bus.servos[servo].table.registers[name])
            for servo in bus.servos
            for name in EEPROM
            if name in bus.servos[servo].table.registers
        }


def read_in_time(bus, servo, register):
    for _ in range(TRIES):
        with contextlib.suppress(BusError):
            return bus.read(servo, register, raw=True)
    raise AssertionError(f"servo {servo} is not read")


def narrow_limits(arm, port):
    """Write a limit to each servo that a search removes."""
    with open_bus(load_model(arm), port) as bus:
        line = ServoLine(bus)
        for servo in bus.servos.values():
            values = {servo.table.registers["max_position_limit"]: 4000}
            for _ in range(TRIES):
                with contextlib.suppress(BusError):
                    write_registers(line, servo, plan_writes(line, servo, values))
                    break


def end_calibration(arm, port, log, moment, how):
    """Start a calibration and end it by a signal at a given moment; return its exit code."""
    for _ in range(TRIES):
        log.write_text("")
        with (
            log.open("w") as output,
            subprocess.Popen(
                [*IKSERVO, "calibrate", arm, "--auto", "--yes", "--port", port],
                stdin=subprocess.DEVNULL, stdout=output, stderr=output, env=dict(os.environ),
            ) as process,
        ):  # fmt: skip
            if came_to(moment, process, log):
                process.send_signal(how)
                return process.wait(60)
        assert process.returncode == 4, log.read_text()
    raise AssertionError(log.read_text())


def came_to(moment, process, log):
    clock = RealClock()
    while process.poll() is None:
        if moment in log.read_text() or (
            moment == "first write" and any(config_dir().glob("journal/*.toml"))
        ):
            return True
        clock.sleep_until(clock.now_s() + 0.002)
    return False


def run_in_time(run_cli, words):
    for _ in range(TRIES):
        done = run_cli(words)
        if done.code != 4:
            break
    return done


@pytest.mark.sample(2)
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM], ids=lambda how: how.name)
@pytest.mark.parametrize("moment", MOMENTS)
@pytest.mark.parametrize("arm", ["so101", "koch"])
def test_killed_calibration_does_not_leave_changed_registers(
    run_cli, tmp_path, monkeypatch, arm, moment, how
):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path / "home"))
    log = tmp_path / "log"
    with served(arm) as (port, _):
        where = f"where --arm {arm} --port {port} --uncalibrated"
        doctor = f"doctor --arm {arm} --port {port}"
        narrow_limits(arm, port)
        before = read_eeprom(arm, port)
        code = end_calibration(arm, port, log, moment, how)
        assert code == (130 if how == signal.SIGTERM else -signal.SIGKILL), log.read_text()
        left = read_eeprom(arm, port)
        if how == signal.SIGTERM:
            said = ("ikservo calibration revert", "settings of the servos were restored")
            assert any(each in log.read_text() for each in said)
        opened = run_in_time(run_cli, where)
        if opened.code:  # torque is on, so that registers cannot be written
            assert opened.code == 6, opened.err
            assert "ikservo calibration revert" in opened.err
            assert left != before
            examined = run_in_time(run_cli, doctor)
            assert examined.code == 1
            assert "a calibration was interrupted while it changed servos" in examined.out
            run_in_time(run_cli, f"relax --arm {arm} --port {port} --yes")
            assert run_in_time(run_cli, where).code == 0
        assert read_eeprom(arm, port) == before
        assert "interrupted" not in run_in_time(run_cli, doctor).out
