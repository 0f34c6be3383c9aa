"""Programs are killed between the unlocking and the locking of an EEPROM."""

import os
import random
import signal
import subprocess
import sys
import time

import pytest

from ikservo.apps.workbench.servo_checks import check_servos
from ikservo.apps.workbench.servo_workbench import (
    ServoLine,
    find_register,
    plan_writes,
    write_registers,
)
from ikservo.hardware import ServoBus, ServoSpec
from ikservo.hardware.port import open_port
from ikservo.registers import MODELS
from tests.journeys.simulator_process import run_simulator

WANTED, MOST = 100, 1000
TABLE = MODELS["STS3215"]
SERVO = ServoSpec(3, TABLE)
WRITER = """
import itertools, sys
from ikservo.hardware import ServoBus, ServoSpec
from ikservo.hardware.port import open_port
from ikservo.apps.workbench.servo_workbench import ServoLine, find_register
from ikservo.apps.workbench.servo_workbench import plan_writes, write_registers
from ikservo.registers import MODELS

table = MODELS["STS3215"]
servo = ServoSpec(3, table)
line = ServoLine(ServoBus(open_port(sys.argv[1], 1_000_000), [servo]))
print("writes", flush=True)
for raw in itertools.cycle((20, 21)):
    values = {find_register(table, name): raw for name in ("p_gain", "d_gain")}
    write_registers(line, servo, plan_writes(line, servo, values))
"""


@pytest.mark.campaign
@pytest.mark.timeout(3600)
def test_eeprom_left_unlocked_by_killed_program_is_locked_again(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path / "home"))
    dice, left_open, kills = random.Random(7), 0, 0
    with run_simulator(tmp_path / "line", "--servo", "3:sts3215") as simulator:
        port = str(simulator.port)
        while left_open < WANTED:
            kills += 1
            assert kills <= MOST
            kill_a_writer(port, dice.uniform(0.0, 0.1))
            with ServoBus(open_port(port, 1_000_000), [SERVO]) as bus:
                if bus.read(3, TABLE.eeprom_lock, raw=True):
                    continue
                left_open += 1
                said = [each.text for each in check_servos(bus, None) if each.topic == "lock"]
                assert said == ["id 3 has its EEPROM unlocked"]
                line = ServoLine(bus)
                values = {find_register(TABLE, "p_gain"): 32, find_register(TABLE, "d_gain"): 32}
                write_registers(line, SERVO, plan_writes(line, SERVO, values))
                assert bus.read(3, TABLE.eeprom_lock, raw=True) == 1
                assert [bus.read(3, r, raw=True) for r in values] == [32, 32]
    print(f"{left_open} locks left open by {kills} kills, all closed")  # noqa: T201


def kill_a_writer(port, after_s):
    """Start a program that writes EEPROM forever, and kill it after the given time."""
    environment = {**os.environ, "IKSERVO_PORT": ""}
    writer = subprocess.Popen([sys.executable, "-c", WRITER, port], env=environment,
                              stdout=subprocess.PIPE)  # fmt: skip
    try:
        assert writer.stdout.readline() == b"writes\n"
        time.sleep(after_s)
    finally:
        writer.send_signal(signal.SIGKILL)
        writer.communicate()
