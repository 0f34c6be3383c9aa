"""Every public method of `Arm`, on every arm, from every posture, on every kind of port."""

import random

import pytest

import ikservo
from ikservo.errors import IkservoError
from tests.cli.conftest import CommandResult
from tests.journeys.expectations import (
    allowed_method_codes,
    find_faults,
    isolate_user_files,
    on_every_arm,
    parameter_names,
)
from tests.journeys.fixtures_ports import PORT_KINDS, place_arm
from tests.journeys.method_arguments import LISTENING, PLUGGED, arguments, methods
from tests.journeys.postures import FREQUENT, postures_of

LIKE = {"move_to": "move", "relax": "relax", "pose": "pose"}  # judged as these commands are


def cases(arm):
    """Return every case of an arm: method, posture, kind of port."""
    called = [name for name in methods() if name not in LISTENING + PLUGGED]
    return [
        (m, posture, kind) for m in called for posture in postures_of(arm) for kind in PORT_KINDS
    ]


def some(arm):
    """Return four methods of an arm, each in one case."""
    chance, by_method = random.Random(f"methods {arm}"), {}
    for case in cases(arm):
        if case[1] in FREQUENT:
            by_method.setdefault(case[0], []).append(case)
    return [chance.choice(by_method[m]) for m in chance.sample(sorted(by_method), 4)]


NAMES = parameter_names("method")


def judge(monkeypatch, folder, arm, method, posture, kind):
    isolate_user_files(monkeypatch, folder)
    bench = place_arm(monkeypatch, arm, posture, kind)
    with ikservo.open_arm(arm, port=bench.port) as machine:
        result = _called(machine, method, folder, bench.watch)
        allowed = allowed_method_codes(method, posture, machine)
        like = LIKE.get(method, method)
        wrong = find_faults(like, bench, machine.model, result, allowed, posture)
    assert not wrong, (wrong, result.err)


def _called(machine, method, folder, watch):
    try:
        given = arguments(method, machine, folder)
        watch.restart()  # arguments may come from another arm that moved
        getattr(machine, method)(**given)
    except IkservoError as error:
        return CommandResult(error.exit_code, "", f"{error.message}\n{error.hint}")
    return CommandResult(0, "", "")


def test_every_public_method_is_covered_by_journey_tests(tmp_path):
    with ikservo.open_arm("so101", port="sim:?pose=home") as machine:
        for method in methods():
            arguments(method, machine, tmp_path)


@pytest.mark.sample(10)
@pytest.mark.parametrize(NAMES, on_every_arm(some))
def test_sampled_methods_end_as_allowed_with_safe_arm(
    monkeypatch, tmp_path, arm, method, posture, kind
):
    judge(monkeypatch, tmp_path, arm, method, posture, kind)


@pytest.mark.campaign
def test_every_method_ends_as_allowed_with_safe_arm(
    monkeypatch, tmp_path, arm, method, posture, kind
):
    judge(monkeypatch, tmp_path, arm, method, posture, kind)


test_every_method_ends_as_allowed_with_safe_arm.matrix = (
    NAMES,
    lambda: on_every_arm(cases),
    None,
)
