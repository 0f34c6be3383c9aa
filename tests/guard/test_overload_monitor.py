"""Goals of a pressing joint are drawn back, and never advanced."""

import pytest

from ikservo.guard import OverloadMonitor, OverloadRule
from tests.guard.gates import TICK, make_limits

AT = 2000


def pressed_by_a_load(goal, seconds):
    """Return a monitor of a joint at tick 2000 under a load of 85 %, and its telemetry."""
    monitor = OverloadMonitor([make_limits()])
    monitor.rules["elbow"] = OverloadRule(0.8, 2.0, output_per_rad=4.0)
    news = []
    for cycle in range(round(seconds * 50)):
        time_s = 0.02 * cycle
        monitor.observe_load("elbow", 0.85 if goal > AT else -0.85, time_s)
        assert monitor.draw_back([goal], [AT]) == [goal]
        news += monitor.update([goal], [AT], time_s)
    return monitor, news


@pytest.mark.parametrize("goal", [AT + 10, AT - 10])
def test_overload_monitor_keeps_goal_close_to_overloaded_joint(goal):
    monitor, news = pressed_by_a_load(goal, 1.9)
    assert monitor.seconds_left("elbow") < 0.5
    assert len(news) == 1
    assert "presses with 85 %" in news[0]
    assert monitor.relaxed_goals([goal], [AT]) == [None]


@pytest.mark.parametrize("side", [1, -1])
def test_overload_monitor_reduces_large_lead_after_motion(side):
    monitor, _ = pressed_by_a_load(AT + 10 * side, 0.5)
    drawn = monitor.relaxed_goals([AT + 200 * side], [AT])
    assert side * (drawn[0] - AT) == int(0.6 * 0.8 / 4.0 / TICK)


def test_overload_monitor_ignores_joint_just_below_limit():
    monitor = OverloadMonitor([make_limits()])
    monitor.rules["elbow"] = OverloadRule(0.8, 2.0, output_per_rad=4.0)
    goal = AT + round(0.95 * 0.8 / 4.0 / TICK)
    for cycle in range(250):  # at first it is where it should be, then its reference goes on
        reference = AT if cycle < 200 else AT + 200
        assert monitor.draw_back([goal], [AT]) == [goal]
        news = monitor.update([goal], [AT], 0.02 * cycle, [reference])
        assert news == ()
    assert monitor.relaxed_goals([goal], [AT]) == [None]
