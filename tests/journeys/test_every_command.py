"""Every command on every arm, from every posture, on every kind of port.

The whole matrix is a campaign; the suite runs a random part of it, with a fixed seed, and some
commands on a limp arm (test_limp_arms.py).
"""

import random

import pytest

from ikservo.model import load_model
from tests.cli.fixtures_ports import run_arguments
from tests.journeys.command_arguments import SERVERS, commands, filled, lines_of
from tests.journeys.expectations import (
    MOVING,
    allowed_command_codes,
    find_faults,
    isolate_user_files,
    on_every_arm,
    parameter_names,
)
from tests.journeys.fixtures_ports import PORT_KINDS, place_arm
from tests.journeys.postures import FREQUENT, postures_of
from tests.journeys.recordings import write_wave_recording
from tests.oracle import ARMS

LONG = ("identify", "test {arm}")  # minutes of motion: campaign, and tests/cli on a small arm
FIRST = ("move", "relax")  # first commands: each arm from its rest
FEW = ("koch",)  # calibrated, too; so101 so in tests/cli/test_wiggle.py


def cases(arm):
    """Return every case of an arm: line, posture, kind of port."""
    return [
        (line, posture, kind)
        for command in commands() if command not in SERVERS
        for line in lines_of(command)
        for kind in PORT_KINDS
        for posture in (postures_of(arm) if command in MOVING else FREQUENT)
    ]  # fmt: skip


def some(arm):
    """Return each command line on every eighth arm, and the first commands on each arm."""
    chance, by_line = random.Random(f"journeys {arm}"), {}
    for case in cases(arm):
        if not case[0].startswith(LONG):
            by_line.setdefault(case[0], []).append(case)
    place = ARMS.index(arm)
    picked = [chance.choice(g) for k, g in enumerate(by_line.values()) if (k + place) % 8 == 0]
    kinds = ("sim", PORT_KINDS[-1]) if arm in FEW else ("sim",)
    first = [
        case for case in cases(arm)
        if case[0].split()[0] in FIRST and case[1] == FREQUENT[0] and case[2] in kinds
    ]  # fmt: skip
    return list(dict.fromkeys(picked + first))


def name_of(value):
    return value.split(" --")[0] if isinstance(value, str) else value


NAMES = parameter_names("line")


def judge(monkeypatch, folder, arm, line, posture, kind):
    isolate_user_files(monkeypatch, folder)
    command, model = line.split()[0], load_model(arm)
    if "wave.jsonl" in line and command != "record":
        write_wave_recording(arm, folder / "wave.jsonl")
    if "stroke.csv" in line:
        (folder / "stroke.csv").write_text("x_mm,y_mm\n0,0\n-10,0\n-10,10\n")
    if "scene.toml" in line:
        far = "centre_m = [0.0, 5.0, 0.0]\nradius_m = 0.1\n"
        (folder / "scene.toml").write_text(f'[[sphere]]\nname = "the ball"\n{far}')
    if "program.toml" in line:
        run_arguments(["program", "new", f"{folder}/program.toml", "--arm", arm])
    bench = place_arm(monkeypatch, arm, posture, kind)
    result = run_arguments(filled(line, arm, bench.port, folder))
    allowed = allowed_command_codes(command, kind, posture, model)
    wrong = find_faults(command, bench, model, result, allowed, posture)
    assert not wrong, (wrong, (result.out + result.err)[-900:])


def test_every_command_is_covered_by_journey_tests():
    assert all(lines_of(command) for command in commands())


@pytest.mark.sample(5)
@pytest.mark.parametrize(NAMES, on_every_arm(some), ids=name_of)
def test_sampled_commands_exit_with_valid_code_and_safe_arm(
    monkeypatch, tmp_path, arm, line, posture, kind
):
    judge(monkeypatch, tmp_path, arm, line, posture, kind)


@pytest.mark.campaign
def test_every_command_exits_with_allowed_code_and_safe_arm(
    monkeypatch, tmp_path, arm, line, posture, kind
):
    judge(monkeypatch, tmp_path, arm, line, posture, kind)


test_every_command_exits_with_allowed_code_and_safe_arm.matrix = (
    NAMES,
    lambda: on_every_arm(cases),
    name_of,
)
