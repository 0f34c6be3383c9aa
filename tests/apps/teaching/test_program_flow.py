"""Conditions, grids, called programs, pauses and endless repetition of programs."""

from itertools import islice

import numpy as np
import pytest

import ikservo
from ikservo.apps.teaching.program import Program, ProgramStep, read_program, write_program
from ikservo.apps.teaching.program_run import ProgramRun
from ikservo.errors import (
    BadValueError,
    FileFormatError,
    InputError,
    LatchedStopError,
    StoppedError,
)
from tests.arm.simulated import true_tip_m
from tests.arm.test_gripper import open_jaws, put_between

NEAR = (0.22, 0.04, 0.12)
GRID = {"rows": 2, "columns": 2, "row_m": (0.0, -0.04, 0.0), "column_m": (0.03, 0.0, 0.0)}
WAIT = {"wait_s": 0.01}


@pytest.fixture
def arm():
    with ikservo.open_arm("so101", port="sim:?pose=home") as machine:
        yield machine


def program(*steps, **options):
    made = tuple(ProgramStep(**step) for step in steps)
    return Program(format=1, arm=options.pop("arm", "so101"), steps=made, **options)


def make_run(arm, folder, *steps, **options):
    return ProgramRun(arm, program(*steps, **options), folder, arm.poses)


def run_all(run, count=None):
    """Run the steps, at most ``count``, and return their numbers."""
    numbers = []
    for step in islice(run.steps(), count):
        run.run_step(step)
        numbers.append(step.number)
    return numbers


def test_each_repetition_moves_to_next_grid_position(arm, tmp_path):
    run, tips = make_run(arm, tmp_path, {"tip_m": NEAR, "grid": GRID}, repeat=5), []
    for step in run.steps():
        run.run_step(step)
        tips.append(true_tip_m(arm))
    places = [(0.22, 0.04), (0.25, 0.04), (0.22, 0.0), (0.25, 0.0), (0.22, 0.04)]
    assert np.abs(np.array(tips)[:, :2] - places).max() < 0.003


def test_unreachable_grid_position_is_found_before_motion(arm, tmp_path):
    far = {**GRID, "rows": 1, "columns": 3, "column_m": (0.35, 0.0, 0.0)}
    checks = list(make_run(arm, tmp_path, {"tip_m": NEAR, "grid": far}, repeat=3).check())
    assert [check.error is None for check in checks] == [True, False, False]
    few = list(make_run(arm, tmp_path, {"tip_m": NEAR, "grid": far}).check())
    assert [check.error is None for check in few] == [True]  # one repetition uses one place


def test_if_grasped_steps_are_skipped_with_empty_gripper(arm, tmp_path):
    steps = ({"gripper": "close"}, {**WAIT, "only_if": "grasped"},
             {**WAIT, "only_if": "not grasped"})  # fmt: skip
    assert run_all(make_run(arm, tmp_path, *steps)) == [1, 3]


@pytest.mark.full
def test_if_grasped_steps_run_with_object_in_gripper(arm, tmp_path):
    open_jaws(arm)
    put_between(arm, 0.4)
    steps = ({"gripper": "close"}, {**WAIT, "only_if": "grasped"},
             {**WAIT, "only_if": "not grasped"})  # fmt: skip
    assert run_all(make_run(arm, tmp_path, *steps)) == [1, 2]


def test_called_program_runs_its_repetitions_within_one_step(arm, tmp_path):
    write_program(tmp_path / "inner.toml", program(WAIT, WAIT, repeat=3))
    run = make_run(arm, tmp_path, WAIT, {"program": "inner.toml"}, WAIT)
    assert run_all(run) == [1, *[2] * 6, 3]
    assert [check.number for check in run.check()] == [1, 2, 2, 2, 3]


def test_called_program_of_another_arm_is_refused(arm, tmp_path):
    write_program(tmp_path / "inner.toml", program(WAIT, arm="koch"))
    with pytest.raises(BadValueError, match="is for koch"):
        make_run(arm, tmp_path, {"program": "inner.toml"})


@pytest.mark.parametrize("inner", [
    program({"program": "inner.toml"}), program(WAIT, repeat="until stopped")
], ids=["calls itself", "never ends"])  # fmt: skip
def test_called_program_that_calls_or_never_ends_is_refused(arm, tmp_path, inner):
    write_program(tmp_path / "inner.toml", inner)
    with pytest.raises(InputError, match="cannot be called, because it"):
        make_run(arm, tmp_path, {"program": "inner.toml"})


def test_error_names_missing_called_program(arm, tmp_path):
    with pytest.raises(FileFormatError, match="gone"):
        make_run(arm, tmp_path, {"program": "gone.toml"})


def test_program_with_endless_repeat_runs_until_stopped(arm, tmp_path):
    run = make_run(arm, tmp_path, WAIT, WAIT, repeat="until stopped")
    assert run_all(run, 301) == [1, 2] * 150 + [1]
    step = next(run.steps())
    arm.stop("Stopped by the test.")
    with pytest.raises(LatchedStopError):
        run.run_step(step)


def test_endless_program_ends_if_no_step_condition_holds(arm, tmp_path):
    run = make_run(arm, tmp_path, {**WAIT, "only_if": "grasped"}, repeat="until stopped")
    assert run_all(run) == []


def test_program_pause_step_keeps_its_text_and_passes_check(arm, tmp_path):
    run = make_run(arm, tmp_path, WAIT, {"pause": "Put in the next part."}, WAIT)
    assert run.pauses
    assert [step.step.pause for step in run.steps()] == [None, "Put in the next part.", None]
    assert [check.error for check in run.check()] == [None] * 3


@pytest.mark.parametrize(("step", "words"), [
    ({"wait_s": 1.0, "grid": GRID}, "a grid, which wait_s cannot have"),
    ({"tip_m": NEAR, "path": "arc", "via_m": NEAR, "grid": GRID}, "an arc cannot have"),
    ({"pause": "x", "speed": "slow"}, "has a speed, which pause cannot have"),
    ({"tip_m": NEAR, "grid": {**GRID, "rows": 31}}, "less than or equal to 30"),
    ({**WAIT, "only_if": "seen"}, "grasped"),
    ({"pause": "x", "program": "y.toml"}, "program and pause"),
])  # fmt: skip
def test_program_step_with_conflicting_keys_is_refused(step, words):
    with pytest.raises(ValueError, match=words):
        ProgramStep(**step)


def test_program_flow_control_keys_survive_write_and_read(tmp_path):
    steps = ({"tip_m": NEAR, "grid": GRID, "only_if": "grasped"}, {"program": "inner.toml"},
             {"pause": "Put in the next part."})  # fmt: skip
    written = program(*steps, repeat="until stopped")
    write_program(tmp_path / "all.toml", written)
    assert read_program(tmp_path / "all.toml") == written
    assert [step.description for step in written.steps] == [
        "if grasped, joints to (0.220, 0.040, 0.120) m", "program inner.toml",
        "pause: Put in the next part."]  # fmt: skip
    assert not written.is_sequence


def test_program_continues_in_a_given_repetition(arm, tmp_path):
    run = make_run(arm, tmp_path, {"tip_m": NEAR, "grid": GRID}, WAIT, repeat=4)
    steps = [(step.repetition, step.number, step.step.tip_m) for step in run.steps(2, 3)]
    assert [each[:2] for each in steps] == [(3, 2), (4, 1), (4, 2)]
    assert steps[1][2] == pytest.approx((0.25, 0.0, 0.12))


def test_program_check_refuses_too_many_grid_positions(arm, tmp_path, monkeypatch):
    monkeypatch.setattr("ikservo.apps.teaching.program_run.MAX_CHECKS", 10)
    run = make_run(arm, tmp_path, {"tip_m": NEAR, "grid": {**GRID, "rows": 8}}, repeat=16)
    with pytest.raises(InputError, match="more than 10 steps"):
        list(run.check())


def test_stop_ends_a_program_check(arm, tmp_path):
    checks = make_run(arm, tmp_path, *[{"tip_m": NEAR}] * 3).check()
    next(checks)
    arm.stop("Stopped by the test.")
    with pytest.raises(StoppedError):
        next(checks)


def test_stop_is_noticed_even_in_shortest_program_wait(arm, tmp_path):
    run = make_run(arm, tmp_path, {"wait_s": 1e-12}, repeat="until stopped")
    step = next(run.steps())
    arm.stop("Stopped by the test.")
    with pytest.raises(LatchedStopError):
        run.run_step(step)
