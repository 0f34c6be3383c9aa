"""If a program is killed while it tries gains, they are found, reported and restored."""

import os
import signal
import subprocess
import sys

import pytest

from ikservo.apps.workbench.findings import Severity
from ikservo.apps.workbench.gain_search import keeping_gains
from ikservo.apps.workbench.servo_checks import check_servos
from ikservo.apps.workbench.servo_workbench import ServoLine, plan_writes, write_registers
from ikservo.apps.workbench.tried_values import note_former, restore_former, tried_differences
from ikservo.errors import FileFormatError
from ikservo.files.reading import config_dir
from ikservo.hardware import ServoBus, ServoSpec
from ikservo.hardware.port import open_port
from ikservo.registers import MODELS
from tests.journeys.simulator_process import run_simulator

TABLE = MODELS["STS3215"]
SERVO, OTHER, P_GAIN = ServoSpec(3, TABLE), ServoSpec(4, TABLE), TABLE.registers["p_gain"]
TRIAL = """
import sys, time
from ikservo.hardware import ServoBus, ServoSpec
from ikservo.hardware.port import open_port
from ikservo.apps.workbench.gain_search import keeping_gains, write_gains
from ikservo.registers import MODELS

servo = ServoSpec(3, MODELS["STS3215"])
bus = ServoBus(open_port(sys.argv[1], 1_000_000), [servo])
with keeping_gains(bus, servo) as present:
    write_gains(bus, servo, {MODELS["STS3215"].registers["p_gain"]: 99})
    print("tries", flush=True)
    time.sleep(60)
"""


@pytest.fixture
def left(tmp_path, monkeypatch):
    """A bus with a servo that has the gain of a killed program."""
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path / "home"))
    with run_simulator(
        tmp_path / "line", "--servo", "3:sts3215", "--servo", "4:sts3215"
    ) as simulator:
        program = subprocess.Popen([sys.executable, "-c", TRIAL, str(simulator.port)],
                                   stdout=subprocess.PIPE, env={**os.environ})  # fmt: skip
        assert program.stdout.readline() == b"tries\n"
        program.send_signal(signal.SIGKILL)
        program.communicate()
        with ServoBus(open_port(str(simulator.port), 1_000_000), [SERVO]) as bus:
            assert bus.read(3, P_GAIN, raw=True) == 99
            yield bus


def trial_findings(bus):
    return [each for each in check_servos(bus, None) if each.topic == "trial"]


@pytest.mark.full
def test_doctor_reports_left_trial_gains_and_restores_old_ones(left):
    (finding,) = trial_findings(left)
    assert finding.level is Severity.ODD
    assert "p_gain 99, not 32" in finding.text
    assert [each.register for each in restore_former(left, SERVO)] == [P_GAIN]
    assert left.read(3, P_GAIN, raw=True) == 32
    assert trial_findings(left) == []


@pytest.mark.full
def test_next_gain_trial_restores_gains_of_killed_trial(left):
    with keeping_gains(left, SERVO) as present:
        assert present[P_GAIN] == 32
    assert trial_findings(left) == []


@pytest.mark.full
def test_servo_gains_written_after_killed_trial_are_kept(left):
    line = ServoLine(left)
    write_registers(line, SERVO, plan_writes(line, SERVO, {P_GAIN: 40}))
    assert trial_findings(left) == []
    assert restore_former(left, SERVO) == []
    assert left.read(3, P_GAIN, raw=True) == 40


@pytest.mark.full
@pytest.mark.parametrize("text", ["", "[]", '{"p_gian": 3}', '{"p_gain": "x"}', "[" * 9000, "\xff"])
def test_doctor_names_damaged_gain_trial_file(left, text):
    (path,) = (config_dir() / "tried").iterdir()
    path.write_text(text)
    with pytest.raises(FileFormatError, match="is damaged"):
        tried_differences(left, SERVO)
    (finding,) = trial_findings(left)
    assert finding.level is Severity.BAD
    assert path.name in finding.text
    assert "rename the file" in finding.fix


@pytest.mark.full
def test_damaged_gain_trial_file_does_not_block_other_servos(left):
    (path,) = (config_dir() / "tried").iterdir()
    path.write_text("[]")
    both = ServoBus(left.port, [SERVO, OTHER])
    note_former(both, OTHER, {P_GAIN: 31})
    damaged, tried = trial_findings(both)
    assert (damaged.level, tried.level) == (Severity.BAD, Severity.ODD)
    assert "p_gain 32, not 31" in tried.text
    line = ServoLine(both)
    for servo in (SERVO, OTHER):
        write_registers(line, servo, plan_writes(line, servo, {P_GAIN: 40}))
        assert both.read(servo.id, P_GAIN, raw=True) == 40
    assert path.read_text() == "[]"
    assert [each.level for each in trial_findings(both)] == [Severity.BAD]
