"""Every command on every arm, from every posture, on every kind of line: nobody is left alone.

The whole matrix is a campaign; the suite runs a share of it that chance, with a fixed seed, picks
anew for each command and arm, and the commands that people type first in full.
"""

import random

import pytest

from ikservo.model import load_model
from tests.cli.desk import run_words
from tests.journeys.judging import MOVING, at_home, codes_of_command, faults, names_of, on_every_arm
from tests.journeys.lines import LINES, put
from tests.journeys.postures import OFTEN, postures_of
from tests.journeys.recorded import record_a_wave
from tests.journeys.typed import SERVERS, commands, filled, lines_of
from tests.oracle import ARMS

FIRST = ("move", "relax")  # typed by everybody: each arm as it lies at rest
FEW = ("koch",)  # calibrated, too; so101 so in tests/cli/test_wiggle.py


def cases(arm):
    """Return every case of an arm: line, posture, kind of line."""
    return [
        (line, posture, kind)
        for command in commands() if command not in SERVERS
        for line in lines_of(command)
        for kind in LINES
        for posture in (postures_of(arm) if command in MOVING else OFTEN)
    ]  # fmt: skip


def some(arm):
    """Return the share of an arm's cases that the suite runs: each line on every eighth arm."""
    chance, by_line = random.Random(f"journeys {arm}"), {}
    for case in cases(arm):
        by_line.setdefault(case[0], []).append(case)
    place = ARMS.index(arm)
    picked = [chance.choice(g) for k, g in enumerate(by_line.values()) if (k + place) % 8 == 0]
    kinds = ("sim", LINES[-1]) if arm in FEW else ("sim",)
    first = [
        case for case in cases(arm)
        if case[0].split()[0] in FIRST and case[1] == OFTEN[0] and case[2] in kinds
    ]  # fmt: skip
    return list(dict.fromkeys(picked + first))


def name_of(value):
    return value.split(" --")[0] if isinstance(value, str) else value


NAMES = names_of("line")


def judge(monkeypatch, folder, arm, line, posture, kind):
    at_home(monkeypatch, folder)
    command, model = line.split()[0], load_model(arm)
    if "wave.jsonl" in line and command != "record":
        record_a_wave(arm, folder / "wave.jsonl")
    bench = put(monkeypatch, arm, posture, kind)
    said = run_words(filled(line, arm, bench.port, folder))
    allowed = codes_of_command(command, kind, posture, model)
    wrong = faults(command, bench, model, said, allowed)
    assert not wrong, (wrong, (said.out + said.err)[-900:])


def test_each_command_has_a_line_that_a_person_would_type():
    assert all(lines_of(command) for command in commands())


@pytest.mark.parametrize(NAMES, on_every_arm(some), ids=name_of)
def test_a_command_ends_well(monkeypatch, tmp_path, arm, line, posture, kind):
    judge(monkeypatch, tmp_path, arm, line, posture, kind)


@pytest.mark.campaign
def test_every_command_ends_well(monkeypatch, tmp_path, arm, line, posture, kind):
    judge(monkeypatch, tmp_path, arm, line, posture, kind)


test_every_command_ends_well.matrix = (NAMES, lambda: on_every_arm(cases), name_of)
