"""Goals of a motion: smooth starts, bounded feedback, and limits."""

from __future__ import annotations

import numpy as np
import pytest

import ikservo
from ikservo.control.goal_compensation import GoalCompensator
from ikservo.motion import TrajectoryPoint

CYCLE_S = 0.005


@pytest.fixture
def arm():
    with ikservo.open_arm("so101", port="sim:?pose=home") as opened:
        opened.enable()
        yield opened


@pytest.fixture
def compensator(arm):
    return arm._context.servos.compensator


@pytest.fixture
def start(arm):
    return arm._context.servos.reference()


def gliding(start, velocity, time_s):
    rates = np.zeros_like(start)
    rates[0] = velocity
    return TrajectoryPoint(start + rates * time_s, rates, np.zeros_like(start))


def goals_of(compensator, start, velocity, seconds):
    times_s = np.arange(0.0, seconds, CYCLE_S)
    return np.array([compensator.goals(gliding(start, velocity, t), CYCLE_S) for t in times_s])


def test_compensated_first_goal_continues_previous_goal(compensator, start):
    compensator.begin(start, start + 0.02)
    first = compensator.goals(gliding(start, 0.0, 0.0), CYCLE_S)
    np.testing.assert_allclose(first[:5], start[:5] + 0.02, atol=1e-3)


def test_compensated_goals_do_not_jump_at_start_of_motion(compensator, start):
    compensator.begin(start, start + 0.05)
    goals = goals_of(compensator, start, 0.3, 0.5)
    assert np.abs(np.diff(goals, axis=0)).max() < 0.006  # 4 ticks


def test_compensation_keeps_goal_offset_within_friction_at_rest(compensator, start):
    compensator.begin(start, start + 0.004)
    goals = goals_of(compensator, start, 0.0, 1.0)
    np.testing.assert_allclose(goals[:, 4], start[4] + 0.004, atol=1e-9)


def test_compensation_has_same_lead_after_control_loop_stall(compensator, start):
    leads = []
    for cycle_time_s in (0.02, None):  # a goal is held for two hundredths of a second
        compensator.begin(start, start, cycle_time_s)
        goals = goals_of(compensator, start, 0.3, 0.5)
        leads.append((goals[-1] - start)[0])
    assert leads[1] == pytest.approx(leads[0])


def test_joint_sagged_at_torque_on_gets_under_half_of_lead(compensator, start):
    lift = -np.eye(6)[2]
    leads = []
    for measured in (start, start - 0.05 * lift):
        compensator.begin(start, start, CYCLE_S, measured)
        for t in np.arange(0.0, 0.05, CYCLE_S):
            point = TrajectoryPoint(start + 0.1 * t * lift, 0.1 * lift, np.zeros(6))
            goals = compensator.goals(point, CYCLE_S)
        leads.append((goals - point.position) @ lift)
    upright, sagged = leads
    assert 0.0 < sagged < 0.5 * upright


def test_compensation_offset_is_kept_while_joint_lags(compensator, start):
    compensator.begin(start, start + 0.02)
    ease = np.where(np.arange(6) == 1, 0.0, 1.0)
    for _t in np.arange(0.0, 0.2, CYCLE_S):
        point = TrajectoryPoint(start, np.full(6, 0.1), np.zeros(6))
        offset = compensator.goals(point, CYCLE_S, ease=ease) - start
    drive = compensator.feed_forward.parameters.drives[1]
    late_s = drive.delay_s + drive.damping_nm_s / drive.stiffness_nm_rad  # no friction: it waits
    assert offset[1] == pytest.approx(0.02 + 0.1 * late_s, abs=0.002)
    assert abs(offset[0] - 0.02) > 0.005


def test_compensation_of_gripper_is_zero(compensator, start):
    compensator.begin(start, start)
    assert goals_of(compensator, start, 0.5, 0.3)[:, 5] == pytest.approx(start[5])


@pytest.mark.full
def test_compensation_of_lagging_joint_grows_up_to_a_bound(compensator, start):
    compensator.begin(start, start)
    leads = []
    for t in np.arange(0.0, 10.0, CYCLE_S):
        point = gliding(start, 0.1, t)
        behind = point.position - 0.01 * np.eye(6)[0]
        leads.append((compensator.goals(point, CYCLE_S) - point.position)[0])
        compensator.observe(behind, 0.0, CYCLE_S, grow=True)
    # 3 a second of the error as a load, and 2 as friction
    assert leads[200] - leads[60] == pytest.approx(5.0 * 0.01 * 140 * CYCLE_S, rel=0.1)
    assert leads[-1] == pytest.approx(leads[-100])
    assert leads[-1] - leads[40] < 0.12


def test_load_learned_while_lowering_is_used_for_lifting(arm):
    # gears under load have more friction: what holds a load as it sinks is too little to lift it
    compensator = arm._context.servos.compensator
    low, high = arm._context.limits()
    lifting = -1.0  # the shoulder of an arm that leans forward
    leaning = np.where(np.arange(6) == 1, 0.5, 0.5 * (low + high))
    unloaded = compensator.stuck_offsets(leaning)
    compensator.begin(leaning, leaning)
    compensator._feedback.integral = 0.02 * lifting * np.eye(6)[1]
    loaded = compensator.stuck_offsets(leaning)
    lifted, lowered = (lifting * (loaded[i] - unloaded[i])[1] for i in (0, 1))
    assert lifted > 0.02 > lowered > 0.0


def test_learned_load_shifts_goal_of_stuck_joint_within_bound(arm):
    compensator = arm._context.servos.compensator
    low, high = arm._context.limits()
    leaning = np.where(np.arange(6) == 1, 0.5, 0.5 * (low + high))
    unloaded = compensator.stuck_offsets(leaning)
    for load in (0.08, -0.08):
        compensator._feedback.integral = load * np.eye(6)[1]
        loaded = compensator.stuck_offsets(leaning)
        moved = [np.abs(loaded[i] - unloaded[i])[1] for i in (0, 1)]
        assert max(moved) == pytest.approx(0.08, abs=0.0015)


def test_learned_load_keeps_its_sign_while_goals_are_limited(compensator, start):
    compensator.begin(start, start)
    compensator.goals(gliding(start, 0.1, 0.0), CYCLE_S)
    compensator._feedback.integral = -0.001 * np.eye(6)[0]
    for _ in range(100):
        compensator.observe(start - 0.1 * np.eye(6)[0], 0.0, CYCLE_S, grow=False)
    assert compensator._feedback.integral[0] == 0.0


def test_compensation_does_not_wind_up_while_goals_are_limited(compensator, start):
    compensator.begin(start, start)
    point = gliding(start, 0.1, 0.0)
    compensator.goals(point, CYCLE_S)
    compensator.observe(point.position - 0.01 * np.eye(6)[0], 0.0, CYCLE_S, grow=True)
    first = compensator._feedback.integral[0]
    for _ in range(100):
        compensator.observe(point.position - 0.01 * np.eye(6)[0], 0.0, CYCLE_S, grow=False)
    assert compensator._feedback.integral[0] == first > 0.0


def test_compensation_ignores_small_error_of_resting_joint(compensator, start):
    compensator.begin(start, start)
    compensator.goals(gliding(start, 0.0, 0.0), CYCLE_S)
    for _ in range(1000):
        compensator.observe(start - 0.004 * np.eye(6)[0], 0.0, CYCLE_S, grow=True)
    assert compensator._feedback.integral[0] == 0.0


def test_compensated_goals_stay_inside_the_limits(arm, compensator, start):
    low, high = arm._context.limits()
    at_the_end = np.where(np.arange(6) == 1, high, start)
    compensator.begin(at_the_end, np.minimum(at_the_end, high))
    goals = goals_of(compensator, at_the_end, 0.0, 0.5)
    assert (goals <= high).all()
    assert (goals >= low).all()


def test_compensated_goal_outside_limits_only_moves_inwards(arm, compensator, start):
    low, _ = arm._context.limits()
    outside = np.where(np.arange(6) == 1, low - 0.1, start)
    compensator.begin(outside, outside)
    goals = []
    for t in np.arange(0.0, 1.0, CYCLE_S):
        point = gliding(outside, 0.05, t)
        moved = point.position + 0.05 * t * np.eye(6)[1]
        goals.append(
            compensator.goals(TrajectoryPoint(moved, np.full(6, 0.05), np.zeros(6)), CYCLE_S)
        )
        # it swings: it runs ahead of its reference and falls behind it
        compensator.observe(moved + 0.03 * np.sin(20.0 * t), 0.0, CYCLE_S, grow=True)
    shoulder = np.array(goals)[:, 1]
    assert (np.diff(shoulder)[shoulder[:-1] < low[1]] >= 0.0).all()
    assert shoulder[-1] > outside[1] + 0.02


def test_compensation_does_not_wind_up_at_a_limit(arm, compensator, start):
    _, high = arm._context.limits()
    at_the_end = np.where(np.arange(6) == 1, high, start)
    compensator.begin(at_the_end, at_the_end)
    sagging = at_the_end - 0.03 * np.eye(6)[1]
    integrals = []
    for _ in range(200):
        compensator.goals(TrajectoryPoint.at_rest(at_the_end), CYCLE_S)
        compensator.observe(sagging, 0.0, CYCLE_S, grow=True)
        integrals.append(compensator._feedback.integral[1])
    assert integrals[-1] == integrals[10] < 0.005


def test_compensation_leaves_reference_beyond_limits_unchanged(arm, compensator, start):
    _, high = arm._context.limits()
    compensator.begin(start, start)
    outside = np.where(np.arange(6) == 1, high + 0.1, start)
    assert compensator.goals(TrajectoryPoint.at_rest(outside), CYCLE_S)[1] == outside[1]


def test_compensation_without_known_masses_is_feedback_only(arm, start):
    bare = GoalCompensator(arm._context.servos.driven_joints, range(5))
    bare.begin(start, start)
    np.testing.assert_allclose(bare.goals(gliding(start, 0.2, 0.0), CYCLE_S), start)
    bare.observe(start - 0.05, 0.0, CYCLE_S, grow=True)
    assert (bare.goals(gliding(start, 0.2, 0.0), CYCLE_S)[:5] > start[:5]).all()
