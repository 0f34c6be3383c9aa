"""Wrong arguments of the solvers raise one error that names the expected type."""

import math

import numpy as np
import pytest

from ikservo.errors import BadValueError, UnknownNameError
from ikservo.ik import Options, Posture, Solver, Target, Tolerance, solve
from ikservo.ik.batch import solve_batch
from ikservo.model import load_model
from tests.kinematics.chains import planar

ARM = planar(0.3, 0.2)
THERE, HERE = Target((0.3, 0.1, 0.0)), np.zeros(2)


@pytest.mark.parametrize("option", [
    {"restarts": 0}, {"restarts": "3"}, {"restarts": 2.5}, {"restarts": math.nan},
    {"restarts": 10**12}, {"max_iterations": 0}, {"max_iterations": "3"}, {"max_iterations": 2.5},
    {"turn_weight_m_rad": "1"}, {"turn_weight_m_rad": math.nan}, {"turn_weight_m_rad": math.inf},
    {"tolerance": 1e-3}, {"posture": "home"},
], ids=str)  # fmt: skip
def test_solve_refuses_invalid_option(option):
    with pytest.raises(BadValueError, match=next(iter(option))):
        solve(ARM, THERE, **option)


@pytest.mark.parametrize("value", [0.0, -1e-3, math.nan, "1 mm", None])
def test_ik_tolerance_must_be_number_above_zero(value):
    with pytest.raises(BadValueError, match="tolerance in metres"):
        Tolerance(position_m=value)


@pytest.mark.parametrize("numbers", [[10**400, 0, 0], [1j, 0, 0], np.zeros(3, complex), {}, [{}]])
def test_target_position_must_be_real_numbers(numbers):
    with pytest.raises(BadValueError, match="target position"):
        Target(numbers)


@pytest.mark.parametrize("frame", [3, ["l1"], b"l1"])
def test_target_frame_must_be_a_string(frame):
    with pytest.raises(BadValueError, match="The frame"):
        Target((0.3, 0.1, 0.0), frame=frame)


@pytest.mark.parametrize("method", [None, 3, ["auto"]])
def test_ik_method_name_must_be_a_string(method):
    with pytest.raises(UnknownNameError, match="method"):
        solve(ARM, THERE, method=method)


def test_target_offset_of_1e308_m_is_refused():
    with pytest.raises(BadValueError, match="offset_m"):
        Target((0.3, 0.1, 0.0), offset_m=(1e308, 0, 0))


def test_target_direction_is_normalised():
    np.testing.assert_allclose(Target((0, 0, 0), direction=(1e11, 0, 0)).target_axis, [1, 0, 0])


@pytest.mark.parametrize("ask", [
    lambda: Solver(3), lambda: Solver(None), lambda: solve_batch(THERE, [[0, 0, 0]]),
])  # fmt: skip
def test_ik_refuses_value_that_is_not_an_arm(ask):
    with pytest.raises(BadValueError, match="The arm"):
        ask()


def test_solve_batch_and_solver_accept_names_and_models():
    model, point = load_model("so101"), (0.25, 0.05, 0.15)
    start = model.initial_joints()
    expected = solve(model.chain, point, start, nearest=False).q
    for arm in ("so101", model):
        np.testing.assert_array_equal(solve(arm, point, nearest=False).q, expected)
        np.testing.assert_array_equal(solve_batch(arm, [point]).q[0], expected)
        pose = np.eye(4)
        pose[:3, 3] = point
        np.testing.assert_array_equal(Solver(arm)(pose, start)[0], expected)


@pytest.mark.parametrize("kind", [None, 3, ["pose"]])
def test_ik_target_kind_must_be_a_string(kind):
    with pytest.raises(UnknownNameError, match="kind of target"):
        Solver(ARM, kind)


@pytest.mark.parametrize("ask", [
    lambda: Solver(ARM, options={"restarts": 3}), lambda: solve_batch(ARM, [[0, 0, 0]], options=3),
])  # fmt: skip
def test_ik_options_must_be_a_solve_options_object(ask):
    with pytest.raises(BadValueError, match="The value of options"):
        ask()


@pytest.mark.parametrize(("T", "q0"), [
    ("x", HERE), (None, HERE), ([[1], [2, 3]], HERE), (np.eye(4), "home"), (np.eye(4), {}),
])  # fmt: skip
def test_ik_solver_refuses_pose_or_start_that_is_not_numeric(T, q0):
    with pytest.raises(BadValueError, match=r"T_world_tool|q0"):
        Solver(ARM)(T, q0)


def transposed():
    T = np.eye(4)
    T[3, :3] = 0.3, 0.1, 0.0
    return T


@pytest.mark.parametrize("ask", [
    lambda: Solver(ARM)(transposed(), HERE), lambda: solve_batch(ARM, [transposed()]),
])  # fmt: skip
def test_ik_refuses_transposed_pose_matrix(ask):
    with pytest.raises(BadValueError, match="transposed"):
        ask()


@pytest.mark.parametrize("out", [np.zeros(3), 5])
def test_out_array_of_wrong_type_or_size_is_refused(out):
    with pytest.raises(BadValueError, match="out"):
        Solver(ARM)(np.eye(4), HERE, out)


@pytest.mark.parametrize("targets", [3.0, None, "abc", [[1, 2, 3], [1, 2]], [[1e200, 0, 0]]])
def test_batch_of_invalid_targets_is_refused(targets):
    with pytest.raises(BadValueError, match="target"):
        solve_batch(ARM, targets)


@pytest.mark.parametrize("workers", [0, -1, "2", 1.5])
def test_solve_batch_worker_count_must_be_positive_integer(workers):
    with pytest.raises(BadValueError, match="workers"):
        solve_batch(ARM, [[0.3, 0, 0]], workers=workers)


def test_ik_options_are_validated_when_created():
    with pytest.raises(BadValueError, match="posture"):
        Options(posture=[0.0, 0.0])


def test_auto_method_moves_redundant_arm_to_preferred_posture():
    arm = planar(0.3, 0.2, 0.1)
    near = Posture([0.0, 0.0, 1.2], [0.0, 0.0, 1.0])
    target = Target((0.35, 0.1, 0.0))
    plain, leaning = (solve(arm, target, posture=posture) for posture in (None, near))
    assert leaning.reached
    assert abs(leaning.q[2] - 1.2) < 0.01 < abs(plain.q[2] - 1.2)
