"""Every public method of `Arm`, on every arm, from every posture, on every kind of line."""

import random

import pytest

import ikservo
from ikservo.errors import IkservoError
from tests.cli.conftest import Said
from tests.journeys.called import DEPRECATED, LISTENING, PLUGGED, arguments, methods
from tests.journeys.judging import at_home, codes_of_method, faults, names_of, on_every_arm
from tests.journeys.lines import LINES, put
from tests.journeys.postures import OFTEN, postures_of

LIKE = {"move_to": "move", "relax": "relax", "pose": "pose"}  # judged as these commands are


def cases(arm):
    """Return every case of an arm: method, posture, kind of line."""
    called = [name for name in methods() if name not in DEPRECATED + LISTENING + PLUGGED]
    return [(m, posture, kind) for m in called for posture in postures_of(arm) for kind in LINES]


def some(arm):
    """Return the share of an arm's cases that the suite runs."""
    chance, by_method = random.Random(f"methods {arm}"), {}
    for case in cases(arm):
        if case[1] in OFTEN:
            by_method.setdefault(case[0], []).append(case)
    return [chance.choice(by_method[m]) for m in chance.sample(sorted(by_method), 4)]


NAMES = names_of("method")


def judge(monkeypatch, folder, arm, method, posture, kind):
    at_home(monkeypatch, folder)
    bench = put(monkeypatch, arm, posture, kind)
    with ikservo.open_arm(arm, port=bench.port) as machine:
        said = _called(machine, method, folder)
        allowed = codes_of_method(method, posture, machine)
        wrong = faults(LIKE.get(method, method), bench, machine.model, said, allowed)
    assert not wrong, (wrong, said.err)


def _called(machine, method, folder):
    try:
        getattr(machine, method)(**arguments(method, machine, folder))
    except IkservoError as error:
        return Said(error.exit_code, "", f"{error.message}\n{error.hint}")
    return Said(0, "", "")


def test_each_method_can_be_called(tmp_path):
    with ikservo.open_arm("so101", port="sim:?pose=home") as machine:
        for method in methods():
            arguments(method, machine, tmp_path)


@pytest.mark.parametrize(NAMES, on_every_arm(some))
def test_a_method_ends_well(monkeypatch, tmp_path, arm, method, posture, kind):
    judge(monkeypatch, tmp_path, arm, method, posture, kind)


@pytest.mark.campaign
def test_every_method_ends_well(monkeypatch, tmp_path, arm, method, posture, kind):
    judge(monkeypatch, tmp_path, arm, method, posture, kind)


test_every_method_ends_well.matrix = (NAMES, lambda: on_every_arm(cases), None)
