"""Goals keep near the joints as they were last seen, and the motion waits for those that lag."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ikservo.errors import RefusedError
from ikservo.guard import LeadLimiter
from tests.guard.gates import TICK, make_limits

LEAD = 138


def seen_at(tick, time_s=1.0):
    ahead = LeadLimiter(
        [make_limits(speed_tick_s=2000), make_limits("wrist", 4, speed_tick_s=2000)]
    )
    ahead.update_measured({"elbow": tick, "wrist": 2048}, time_s)
    return ahead


@pytest.mark.parametrize("lead", [LEAD, -LEAD, 0])
def test_a_goal_as_far_ahead_as_may_be_passes(lead):
    seen_at(2048).check_lead("elbow", 2048 + lead, 2048, 1.0)


@pytest.mark.parametrize("lead", [LEAD + 1, -LEAD - 1])
def test_a_goal_one_tick_further_ahead_is_refused(lead):
    with pytest.raises(
        RefusedError, match="would be 139 ticks ahead of its position \\(max 138\\)"
    ):
        seen_at(2048).check_lead("elbow", 2048 + lead, 2048, 1.0)


@pytest.mark.parametrize("side", [1, -1])
def test_a_joint_pushed_away_keeps_its_goal_or_gets_it_nearer_but_not_further(side):
    ahead, last = seen_at(2048), 2048 + side * 300
    for goal in (last, last - side * 100, 2048):
        ahead.check_lead("elbow", goal, last, 1.0)
    with pytest.raises(RefusedError):
        ahead.check_lead("elbow", last + side, last, 1.0)


@pytest.mark.parametrize("now_s", [1.0, 1.25])
def test_what_was_seen_stays_true_for_a_quarter_of_a_second(now_s):
    seen_at(2048).check_lead("elbow", 2048, 2048, now_s)


@pytest.mark.parametrize("now_s", [1.2501, 9.0, math.nan])
def test_what_was_seen_long_ago_is_not_known_any_more(now_s):
    with pytest.raises(RefusedError, match=r"from elbow for 0\.25 s"):
        seen_at(2048).check_lead("elbow", 2048, 2048, now_s)


def test_a_joint_that_did_not_answer_keeps_its_last_place_and_time():
    ahead = seen_at(2048)
    ahead.update_measured({"wrist": 2000}, 1.2)
    assert ahead.measured_ticks == {"elbow": 2048, "wrist": 2000}
    ahead.check_lead("wrist", 2000, 2000, 1.4)
    with pytest.raises(RefusedError, match="elbow"):
        ahead.check_lead("elbow", 2048, 2048, 1.4)


@pytest.mark.parametrize("tick", [math.nan, 2048.0, None, True])
def test_a_place_that_is_no_whole_number_is_not_taken_for_any_joint(tick):
    ahead = seen_at(2048)
    with pytest.raises(RefusedError, match="elbow"):
        ahead.update_measured({"wrist": 2000, "elbow": tick}, 1.1)
    assert ahead.measured_ticks["wrist"] == 2048


@pytest.mark.parametrize("time_s", [math.nan, math.inf, -math.inf])
def test_a_place_without_a_time_is_not_taken(time_s):
    ahead = seen_at(2048)
    with pytest.raises(RefusedError, match="time of a measurement"):
        ahead.update_measured({"elbow": 2000}, time_s)
    assert ahead.measured_ticks["elbow"] == 2048


@pytest.mark.parametrize("speed", [0.0, -1.0, math.nan])
def test_a_motion_without_a_speed_is_refused(speed):
    ahead = seen_at(2048)
    with pytest.raises(RefusedError, match="The speed of elbow must be above zero"):
        ahead.set_speeds({"elbow": speed})


def test_each_joint_has_the_look_ahead_of_its_own_speed():
    ahead = seen_at(2048)
    ahead.set_speeds({"elbow": 100 * TICK})
    with pytest.raises(RefusedError, match="max 88"):
        ahead.check_lead("elbow", 2048 + 89, 2048, 1.0)
    ahead.check_lead("wrist", 2048 + LEAD, 2048, 1.0)


# --- waiting


@pytest.mark.parametrize(
    ("goal", "share"),
    [(2048, 1.0), (2048 + 103, 1.0), (2048 + 121, 0.4928), (2048 - 121, 0.4928), (2186, 0.0)],
)
def test_a_motion_waits_from_three_quarters_of_the_look_ahead_on(goal, share):
    ahead = seen_at(2048)
    assert ahead.allowed_advance_s({"elbow": goal}, 0.001) == pytest.approx(share * 0.001, rel=1e-3)


@pytest.mark.parametrize(
    ("goal", "share"), [(2048 + 103, 1.0), (2048 - 121, 0.4928), (2186, 0.0), (2048 + 200, 0.0)]
)
def test_one_joint_that_lags_is_waited_for_by_itself(goal, share):
    assert seen_at(2048).ease("elbow", goal) == pytest.approx(share, rel=1e-3)
    assert seen_at(2048).ease("wrist", 2048) == 1.0


def test_a_joint_that_was_never_seen_is_waited_for():
    assert LeadLimiter([make_limits()]).ease("elbow", 2048) == 0.0


@pytest.mark.parametrize("goal", [2048 + 200, 2048 - 200])
def test_a_motion_never_goes_backwards(goal):
    assert seen_at(2048).allowed_advance_s({"elbow": goal}, 0.01) == 0.0


def test_a_long_cycle_leads_no_further_than_the_lead_limit():
    advance_s = seen_at(2048).allowed_advance_s({"elbow": 2048 + 37}, 0.2)
    assert advance_s == pytest.approx(100 / 2000)  # and one tick left for rounding


def test_a_slow_motion_may_go_on_for_longer():
    ahead = seen_at(2048)
    ahead.set_speeds({"elbow": 1000 * TICK, "wrist": 1000 * TICK})
    assert ahead.allowed_advance_s({"elbow": 2048 + 37}, 0.2) == pytest.approx(100 / 1000)


def test_a_motion_said_to_be_faster_than_its_joint_goes_as_fast_as_the_joint():
    ahead = seen_at(2048)
    ahead.set_speeds({"elbow": 9000 * TICK})
    assert ahead.allowed_advance_s({"elbow": 2048 + 37}, 0.2) == pytest.approx(100 / 2000)


def test_the_slowest_joint_decides():
    goals = {"elbow": 2048 + 121, "wrist": 2048}
    assert seen_at(2048).allowed_advance_s(goals, 0.001) == pytest.approx(0.0004928, rel=1e-3)


def test_a_joint_that_was_never_seen_lets_nothing_go_on():
    ahead = LeadLimiter([make_limits(), make_limits("wrist", 4)])
    ahead.update_measured({"wrist": 2048}, 1.0)
    assert ahead.allowed_advance_s({"elbow": 2048, "wrist": 2048}, 0.01) == 0.0


def test_where_nothing_was_sent_nothing_waits():
    assert seen_at(2048).allowed_advance_s({}, 0.01) == 0.01


@given(st.integers(-LEAD, LEAD), st.floats(0.0, 0.05), st.floats(0.0, 0.9999))
def test_goals_that_advance_as_allowed_always_pass(ahead_by, elapsed_s, phase):
    ahead = seen_at(2048)
    goal = 2048 + ahead_by
    further = math.floor(2000 * ahead.allowed_advance_s({"elbow": goal}, elapsed_s) + phase)
    ahead.check_lead("elbow", goal + math.copysign(further, ahead_by), goal, 1.0)
