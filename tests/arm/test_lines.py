"""Straight lines and waypoints, judged by the servos' registers."""

import math

import numpy as np
import pytest

import ikservo
from ikservo.errors import BadValueError, CartesianPathError, RefusedError, UnreachableError
from tests.arm.simulated import line_of, registers, true_tip_m


@pytest.fixture
def arm():
    with ikservo.open_arm("so101", port="sim:?pose=home") as machine:
        yield machine


@pytest.fixture
def ready(arm):
    """Return an arm after its first, slow motion."""
    arm.move_joints({"wrist_roll": 0.05})
    return arm


def tips_m(arm, plan):
    """Execute a plan; return the tip (n, 3) by the servos' registers."""
    tips = []
    arm.execute(plan, lambda _: tips.append(true_tip_m(arm)))
    return np.array(tips)


def from_line_m(points, begin, end):
    along = (end - begin) / np.linalg.norm(end - begin)
    gone = points - begin
    return np.linalg.norm(gone - np.outer(gone @ along, along), axis=1)


@pytest.mark.full
def test_true_tip_stays_within_3_mm_of_the_line(ready):
    ready.move_to((0.22, 0.02, 0.12))  # the first motion lifts an arm that was limp
    begin, goal = true_tip_m(ready), np.array((0.22, -0.08, 0.18))
    tips = tips_m(ready, ready.plan_line(goal))
    np.testing.assert_allclose(true_tip_m(ready), goal, atol=2e-3)
    # Without feed-forward servos would lag and sag under their load: 7 to 20 mm.
    assert from_line_m(tips, begin, goal).max() < 3e-3


def test_line_setpoints_stay_within_1_5_mm_of_the_line(ready):
    plan, goal = ready.plan_line((0.22, -0.08, 0.18)), np.array((0.22, -0.08, 0.18))
    times_s = np.linspace(0.0, plan.duration_s, 200)
    q = np.array([plan.trajectory.state(time_s).position for time_s in times_s])
    tips = ready.chain.forward(q[:, : ready.chain.dof])[:, :3, 3]
    assert from_line_m(tips, tips[0], goal).max() < 1.5e-3


@pytest.mark.full
def test_line_plan_goal_duration_and_length_match_trajectory(ready):
    plan = ready.plan_line((0.22, -0.08, 0.18))
    np.testing.assert_array_equal(plan.trajectory.state(plan.duration_s).position, plan.goal)
    assert plan.trajectory.duration_s == plan.duration_s
    begin_m = ready.chain.forward(plan.trajectory.state(0.0).position[: ready.chain.dof])[:3, 3]
    assert plan.path_m == pytest.approx(np.linalg.norm(plan.tip_m - begin_m), abs=1e-3)


def test_line_plan_lists_limiting_joints_and_limits_nearby(ready):
    plan = ready.plan_line((0.22, -0.08, 0.18))
    assert {words.split()[0] for words in plan.time_limiting_joints} <= set(ready.chain.names)
    assert all(near.margin < 0.2 for near in plan.near_limits)


def test_line_out_of_reach_moves_nothing(ready):
    before = registers(ready, "goal_position")
    with pytest.raises(UnreachableError):
        ready.move_line((0.6, 0.05, 0.15))
    assert registers(ready, "goal_position") == before


@pytest.mark.full
def test_line_through_unreachable_points_moves_nothing(ready):
    ready.move_to((0.0, 0.22, 0.15))
    before = registers(ready, "goal_position")
    with pytest.raises(CartesianPathError) as caught:
        ready.move_line((0.0, -0.22, 0.15))
    assert 0.0 < caught.value.along_m < 0.44
    assert registers(ready, "goal_position") == before


def test_line_through_table_or_arm_is_refused(ready):
    with pytest.raises(RefusedError, match=r"would touch .* (of the path|inside it at the goal)"):
        ready.move_line((0.25, 0.0, -0.05))


@pytest.mark.full
@pytest.mark.sample(1)
@pytest.mark.parametrize("line", [True, False])
def test_waypoints_are_passed_without_a_stop(ready, line):
    via, goal = np.array((0.22, -0.02, 0.2)), np.array((0.2, -0.08, 0.15))
    plan = ready.plan_through([via, goal], line=line, blend_m=0.02)
    states = [plan.trajectory.state(t) for t in np.linspace(0.0, plan.duration_s, 800)]
    tips = ready.chain.forward(np.array([s.position for s in states])[:, : ready.chain.dof])
    assert np.linalg.norm(tips[:, :3, 3] - via, axis=1).min() <= 0.02
    assert min(np.abs(s.velocity).max() for s in states[40:-40]) > 0.01
    assert ready.execute(plan).reached
    np.testing.assert_allclose(true_tip_m(ready), goal, atol=2e-3)


@pytest.mark.parametrize("blend_m", [0.0, -0.01, math.nan, math.inf])
@pytest.mark.parametrize("line", [True, False])
def test_blend_that_is_not_positive_is_refused(arm, blend_m, line):
    with pytest.raises(BadValueError, match="blend"):
        arm.plan_through([(0.25, 0, 0.2), (0.25, 0.05, 0.15)], line=line, blend_m=blend_m)


@pytest.mark.parametrize("points", [[], [(0.25, 0.0)], [(0.25, 0, math.nan)]])
def test_invalid_waypoints_move_nothing(arm, points):
    with pytest.raises(BadValueError):
        arm.move_through(points)
    assert not any(registers(arm, "torque_enable").values())


@pytest.mark.full
def test_plan_is_refused_if_arm_is_not_at_its_start(ready):
    plan = ready.plan_line((0.22, -0.08, 0.18))
    ready.move_joints({"shoulder_pan": 0.4}, speed="fast")
    with pytest.raises(RefusedError, match="not at the start of the plan"):
        ready.execute(plan)


@pytest.mark.full
def test_first_motion_after_torque_on_is_slow(arm):
    first = arm.plan_to((0.25, 0.05, 0.15), speed="fast")
    assert (first.speed, first.speed_reduced) == ("slow", True)
    arm.execute(first)
    second = arm.plan_to((0.22, -0.05, 0.15), speed="fast")
    assert (second.speed, second.speed_reduced) == ("fast", False)


def test_first_motion_is_slow_if_torque_was_already_on(arm):
    arm.enable()
    assert arm.plan_joints({"elbow_flex": 0.3}).speed == "slow"


@pytest.mark.full
def test_holding_arm_moves_at_normal_speed_after_acknowledge(ready):
    servos = line_of(ready).servos
    assert all(servo.read("torque_enable") for servo in servos.values())
    ready.acknowledge()  # as for a program that opens an arm that holds
    assert ready.plan_to((0.22, -0.05, 0.15)).speed == "normal"


@pytest.mark.full
def test_motion_after_torque_off_is_slow_again(ready):
    plan = ready.plan_to((0.22, -0.05, 0.15))
    ready.disable_torque()
    assert ready.plan_to((0.22, -0.05, 0.15)).speed == "slow"
    with pytest.raises(RefusedError, match="Torque was switched off"):
        ready.execute(plan)
