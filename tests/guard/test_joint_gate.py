"""Goals stay near the last measured joints, and the motion waits for joints that lag."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ikservo.errors import RefusedError
from ikservo.guard import Gate
from ikservo.guard.joint_gate import JointGate
from tests.guard.gates import TICK, ManualClock, make_gate_at, make_limits

LEAD = 138
LONG_S = 10.0  # no step is too long for it


def measured_at(tick, *, goal=2048, time_s=1.0):
    joint = JointGate(make_limits(speed_tick_s=2000, low=0, high=4095))
    joint.update_measured(tick, time_s)
    joint.goal = goal
    return joint


@pytest.mark.parametrize("lead", [LEAD, -LEAD, 0])
def test_goal_with_maximum_lead_is_accepted(lead):
    goal = 2048 + lead
    measured_at(2048, goal=goal - 50 * (lead > 0) + 50 * (lead < 0)).check_goal(goal, LONG_S, 1.0)


@pytest.mark.parametrize("lead", [LEAD + 1, -LEAD - 1])
def test_goal_one_tick_beyond_maximum_lead_is_refused(lead):
    joint = measured_at(2048, goal=2048 + lead - (50 if lead > 0 else -50))
    with pytest.raises(
        RefusedError, match="would be 139 ticks ahead of its position \\(max 138\\)"
    ):
        joint.check_goal(2048 + lead, LONG_S, 1.0)


@pytest.mark.parametrize("side", [1, -1])
def test_joint_pushed_beyond_max_lead_may_only_reduce_its_lead(side):
    last = 2048 + side * 300
    joint = measured_at(2048, goal=last)
    for goal in (last, last - side * 100):
        joint.check_goal(goal, LONG_S, 1.0)
    with pytest.raises(RefusedError, match="Following error"):
        joint.check_goal(last + side, LONG_S, 1.0)


@pytest.mark.parametrize("now_s", [1.0, 1.25])
def test_position_measurement_is_valid_for_250_ms(now_s):
    joint = measured_at(2048)
    assert not joint.is_stale(now_s)
    joint.check_goal(2048, LONG_S, now_s)


@pytest.mark.parametrize("now_s", [1.2501, 9.0, math.nan])
def test_goal_is_refused_if_position_reading_is_stale(now_s):
    joint = measured_at(2048)
    assert joint.is_stale(now_s)
    with pytest.raises(RefusedError, match=r"from elbow for 0\.25 s"):
        joint.check_goal(2048, LONG_S, now_s)


def test_unmeasured_joint_counts_as_stale_and_motion_waits():
    joint = JointGate(make_limits())
    assert joint.is_stale(0.0)
    assert joint.ease() == 0.0
    assert joint.allowed_advance_s(0.01) == 0.0


def test_joint_without_answer_keeps_last_position_and_time():
    gate, _, _ = make_gate_at(2048)
    gate.update_measured({"wrist": 2000}, 0.2)
    assert gate.measured_ticks == {"elbow": 2048, "wrist": 2000}
    assert gate.stale_joints(0.3) == ("elbow",)


@pytest.mark.parametrize("tick", [math.nan, 2048.0, "2048", True])
def test_measurement_that_is_not_an_integer_is_ignored_for_all(tick):
    gate, _, _ = make_gate_at(2048)
    with pytest.raises(RefusedError, match="elbow"):
        gate.update_measured({"wrist": 2000, "elbow": tick}, 0.1)
    assert gate.measured_ticks["wrist"] == 2048


@pytest.mark.parametrize("time_s", [math.nan, math.inf, -math.inf])
def test_measurement_with_nan_or_infinite_time_is_ignored(time_s):
    gate, _, _ = make_gate_at(2048)
    with pytest.raises(RefusedError, match="time of a measurement"):
        gate.update_measured({"elbow": 2000}, time_s)
    assert gate.measured_ticks["elbow"] == 2048


@pytest.mark.parametrize("speed", [0.0, -1.0, math.nan])
def test_joint_speed_limit_must_be_above_zero(speed):
    gate, _, _ = make_gate_at(2048, speed_tick_s=2000)
    with pytest.raises(RefusedError, match="The speed of elbow must be above zero"):
        gate.set_speeds({"wrist": 1.0, "elbow": speed})


def test_maximum_lead_follows_speed_of_each_joint():
    gate, _, clock = make_gate_at(2048)
    gate.set_speeds({"elbow": 100 * TICK})
    with pytest.raises(RefusedError, match="max 88"):
        gate.send({"elbow": 2048 + 89})
    gate.send({"wrist": 2048 + LEAD})
    assert clock.now_s() == 0.02


# --- motions wait for joints that lag


@pytest.mark.parametrize(
    ("goal", "share"),
    [(2048, 1.0), (2048 + 103, 1.0), (2048 + 121, 0.4928), (2048 - 121, 0.4928), (2186, 0.0)],
)
def test_motion_slows_from_75_percent_of_maximum_lead(goal, share):
    joint = measured_at(2048, goal=goal)
    assert joint.ease() == pytest.approx(share, rel=1e-3)
    assert joint.allowed_advance_s(0.001) == pytest.approx(share * 0.001, rel=1e-3)


@pytest.mark.parametrize("goal", [2048 + 200, 2048 - 200])
def test_motion_pauses_but_never_reverses_if_lead_is_too_large(goal):
    joint = measured_at(2048, goal=goal)
    assert joint.ease() == 0.0
    assert joint.allowed_advance_s(0.01) == 0.0


def test_allowed_advance_in_long_cycle_respects_maximum_lead():
    advance_s = measured_at(2048, goal=2048 + 37).allowed_advance_s(0.2)
    assert advance_s == pytest.approx(100 / 2000)  # and one tick left for rounding


@pytest.mark.parametrize(("speed", "used"), [(1000, 1000), (9000, 2000)])
def test_allowed_advance_uses_motion_speed_up_to_joint_speed(speed, used):
    joint = measured_at(2048, goal=2048 + 37)
    joint.set_speed(speed * TICK)
    assert joint.allowed_advance_s(0.2) == pytest.approx(100 / used)


def test_joint_with_largest_lag_limits_allowed_advance():
    gate, _, _ = make_gate_at(2048, speed_tick_s=2000)
    gate.update_measured({"elbow": 2048 - 121, "wrist": 2048}, 0.02)
    assert gate.allowed_advance_s(0.001) == pytest.approx(0.0004928, rel=1e-3)


def test_allowed_advance_without_goals_is_full_cycle_time():
    gate = Gate([make_limits()], ManualClock())
    assert gate.allowed_advance_s(0.01) == 0.01


@given(st.integers(-LEAD, LEAD), st.floats(0.0, 0.05), st.floats(0.0, 0.9999))
def test_goals_within_allowed_advance_always_pass_gate(ahead_by, elapsed_s, phase):
    joint = measured_at(2048, goal=2048 + ahead_by)
    further = math.floor(2000 * joint.allowed_advance_s(elapsed_s) + phase)
    goal = 2048 + ahead_by + int(math.copysign(further, ahead_by))
    joint.check_goal(goal, LONG_S, 1.0)
