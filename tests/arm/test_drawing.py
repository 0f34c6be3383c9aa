"""Drawings on simulated arms: commanded path, lift, and strokes out of reach."""

from itertools import pairwise

import numpy as np
import pytest

import ikservo
from ikservo.errors import RefusedError, UnreachableError
from tests.arm.simulated import registers, true_tip_m

CORNER = np.array([0.18, -0.02, 0.09])
SQUARE = CORNER + 0.04 * np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 0]])
DASH = CORNER + 0.04 * np.array([[0.3, 0.5, 0], [0.7, 0.5, 0]])


@pytest.fixture(params=["so101", "wx250s", "open_manipulator_x"])
def arm(request):
    with ikservo.open_arm(request.param, port="sim:?pose=home") as machine:
        machine.pose("home")
        yield machine


def commanded_tips(arm, plan):
    """Return the commanded tip (k, 3) every 5 ms of the Cartesian part."""
    begin_s = plan.duration_s - plan.cartesian_s
    times_s = np.arange(begin_s, plan.duration_s, 0.005)
    joints = np.array([plan.trajectory.state(at_s).position for at_s in times_s])
    return arm.chain.forward(joints[:, list(arm.joint_index.chain)])[:, :3, 3]


def distance_to(points, stroke):
    """Return the distance (k,) of points to a polyline."""
    found = []
    for a, b in pairwise(stroke):
        x = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        found.append(np.linalg.norm(points - a - np.outer(x, b - a), axis=1))
    return np.min(found, axis=0)


@pytest.mark.sample(1)
def test_commanded_tip_of_drawing_is_on_stroke_or_lifted(arm):
    plan = arm.plan_drawing([SQUARE, DASH], lift_m=0.015, tool_speed_m_s=0.03)
    tips = commanded_tips(arm, plan)
    down = tips[tips[:, 2] < CORNER[2] + 3e-4]
    off_m = np.minimum(distance_to(down, SQUARE), distance_to(down, DASH))
    assert off_m.max() < 6e-4
    for corner in (*SQUARE, *DASH):
        assert np.linalg.norm(tips - corner, axis=1).min() < 5e-4
    np.testing.assert_allclose(tips[-1], DASH[-1] + (0, 0, 0.015), atol=5e-4)
    assert tips[:, 2].max() < CORNER[2] + 0.016


@pytest.mark.campaign
def test_drawing_is_executed_and_reports_its_path_error(arm):
    report = arm.draw([SQUARE, DASH], tool_speed_m_s=0.04)
    assert report.reached
    assert np.linalg.norm(true_tip_m(arm) - DASH[-1] - (0, 0, 0.01)) < 2e-3
    assert 0.0 < report.path_error_rms_m < report.path_error_max_m < 0.03


@pytest.mark.full
@pytest.mark.sample(1)
def test_single_point_stroke_is_drawn_and_tip_lifted_again(arm):
    plan = arm.plan_drawing([[CORNER]], lift_m=0.02)
    tips = commanded_tips(arm, plan)
    assert tips[:, 2].min() == pytest.approx(CORNER[2], abs=5e-4)
    assert tips[-1, 2] == pytest.approx(CORNER[2] + 0.02, abs=5e-4)


@pytest.mark.sample(1)
def test_stroke_of_repeated_point_equals_single_point(arm):
    single, repeated = (arm.plan_drawing([[CORNER] * count], lift_m=0.02) for count in (1, 3))
    assert repeated.duration_s == pytest.approx(single.duration_s)
    np.testing.assert_allclose(repeated.goal, single.goal)


@pytest.mark.sample(1)
def test_drawing_error_numbers_points_as_given_with_repeats(arm):
    far = CORNER + np.array([[0, 0, 0], [0, 0, 0], [0.01, 0, 0], [0.9, 0, 0]])
    with pytest.raises(UnreachableError, match="point 4 of stroke 1: "):
        arm.plan_drawing([far])


@pytest.mark.sample(1)
def test_error_names_first_unreachable_point_of_drawing(arm):
    goals = registers(arm, "goal_position")
    far = CORNER + np.array([[0, 0, 0], [0.01, 0, 0], [0.9, 0, 0], [1.0, 0, 0]])
    with pytest.raises(UnreachableError, match="point 3 of stroke 2: ") as raised:
        arm.draw([DASH, far])
    assert "Move the drawing or make it smaller" in raised.value.hint
    assert registers(arm, "goal_position") == goals


@pytest.mark.sample(1)
def test_drawing_below_the_table_is_refused(arm):
    with pytest.raises((RefusedError, UnreachableError)):
        arm.draw([SQUARE - (0, 0, 0.2)])


@pytest.mark.full
def test_drawing_plan_reports_one_tool_speed_for_all_strokes():
    with ikservo.open_arm("so101", port="sim:?pose=home") as arm:
        arm.pose("home")
        speed = arm.plan_drawing([SQUARE, DASH], tool_speed_m_s=0.03).tool_speed
        assert speed.limited_by[0] == "1 of 2 strokes are slower"  # at the corners of the square
        assert speed.top_m_s == pytest.approx(0.03, rel=0.03)
        assert arm.plan_drawing([DASH], tool_speed_m_s=0.01).tool_speed.is_constant
