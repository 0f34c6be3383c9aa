"""For every rule: the last value that passes and the first that does not."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ikservo.errors import ExitCode, RefusedError
from ikservo.guard import StopKind, StopReason
from tests.guard.gates import (
    CYCLE_S,
    ManualClock,
    NamedGate,
    Recorder,
    make_gate_at,
    make_limits,
)

LEAD = 138  # ticks, of a joint at its top speed


@pytest.mark.parametrize(("start", "tick"), [(1010, 1000), (2990, 3000), (1000, 1000)])
def test_gate_accepts_last_tick_inside_limits(start, tick):
    gate, bus, _ = make_gate_at(start)
    gate.send({"elbow": tick})
    assert bus.sent == [{3: tick}]


@pytest.mark.parametrize(("start", "tick"), [(1010, 999), (2990, 3001)])
def test_gate_refuses_first_tick_outside_limits(start, tick):
    gate, bus, _ = make_gate_at(start)
    with pytest.raises(RefusedError) as caught:
        gate.send({"wrist": 2050, "elbow": tick})
    assert caught.value.exit_code == ExitCode.REFUSED
    assert bus.sent == []


def test_gate_refusal_names_joint_goal_limit_and_source():
    gate, _, _ = make_gate_at(2990)
    with pytest.raises(RefusedError, match=r"elbow target 83\.8° .* limit 83\.7° \(hand sweep\)"):
        gate.send({"elbow": 3001})


@pytest.mark.parametrize("direction", [1, -1])
def test_gate_accepts_step_of_speed_limit_plus_one_tick(direction):
    gate, bus, _ = make_gate_at(2048)
    gate.update_measured({"elbow": 2048 + direction * 100}, 0.02)
    gate.send({"elbow": 2048 + direction * 201})  # 10 000 ticks/s, 20 ms, and one of rounding
    assert bus.sent == [{3: 2048 + direction * 201}]


@pytest.mark.parametrize("direction", [1, -1])
def test_gate_refuses_step_of_speed_limit_plus_two_ticks(direction):
    gate, bus, _ = make_gate_at(2048)
    with pytest.raises(RefusedError, match="setpoint step of 202 ticks in 20 ms for elbow"):
        gate.send({"elbow": 2048 + direction * 202})
    assert bus.sent == []


def test_gate_limits_step_after_stall_to_motion_of_50_ms():
    gate, _, clock = make_gate_at(2048)
    clock.time_s = 5.0
    gate.update_measured({"elbow": 2300, "wrist": 2048}, 5.0)
    with pytest.raises(RefusedError, match="step of 502 ticks in 50 ms for elbow \\(max 501\\)"):
        gate.send({"elbow": 2048 + 502})
    gate.send({"elbow": 2048 + 330})


def test_gate_measures_step_from_last_accepted_goal():
    gate, bus, clock = make_gate_at(2048)
    gate.update_measured({"elbow": 2200}, 0.02)
    gate.send({"elbow": 2248})
    clock.time_s = 0.04
    gate.update_measured({"elbow": 2400}, 0.04)
    gate.send({"elbow": 2448})
    assert [goal[3] for goal in bus.sent] == [2248, 2448]


@pytest.mark.parametrize(("start", "inwards", "outwards"), [(950, 960, 949), (3050, 3040, 3051)])
def test_joint_outside_limits_may_only_move_inwards(start, inwards, outwards):
    gate, bus, clock = make_gate_at(start)
    with pytest.raises(RefusedError):
        gate.send({"elbow": outwards})
    gate.send({"elbow": inwards})
    clock.time_s = 0.04
    with pytest.raises(RefusedError):
        gate.send({"elbow": start})
    assert bus.sent == [{3: inwards}]


@pytest.mark.parametrize(
    "tick", [math.nan, math.inf, 2048.0, "2048", True, np.float64(2048), [2048]]
)
def test_gate_refuses_goal_that_is_not_an_integer_for_all_joints(tick):
    gate, bus, _ = make_gate_at(2048)
    with pytest.raises(RefusedError, match="goal of elbow"):
        gate.send({"wrist": 2050, "elbow": tick})
    assert bus.sent == []


def test_gate_refuses_unknown_joint_and_sends_nothing():
    gate, bus, _ = make_gate_at(2048)
    with pytest.raises(RefusedError, match="3 values do not match the 2 joints"):
        gate.send({"wrist": 2050, "elbo": 2048})
    assert bus.sent == []


def test_gate_refuses_goal_before_first_measurement():
    bus = Recorder()
    gate = NamedGate([make_limits()], bus, ManualClock())
    with pytest.raises(RefusedError, match="The position of elbow has not been measured"):
        gate.send({"elbow": 2048})
    assert bus.sent == []


def test_reset_goals_sends_measured_ticks_even_outside_limits():
    bus = Recorder()
    NamedGate([make_limits()], bus, ManualClock()).reset_goals({"elbow": 950})
    assert bus.sent == [{3: 950}]


@pytest.mark.parametrize("tick", [math.nan, 2048.0])
def test_reset_goals_refuses_tick_that_is_not_an_integer(tick):
    bus = Recorder()
    with pytest.raises(RefusedError):
        NamedGate([make_limits()], bus, ManualClock()).reset_goals({"elbow": tick})
    assert bus.sent == []


@pytest.mark.parametrize(("tick", "nearest"), [(999, 1000), (3001, 3000), (1700, 1700)])
def test_gate_clamp_returns_nearest_tick_inside_limits(tick, nearest):
    gate, _, _ = make_gate_at(2048)
    assert gate.clamp("elbow", tick) == nearest


@given(st.lists(st.tuples(st.integers(-200, 4400), st.floats(0, 0.2)), max_size=30))
def test_gate_never_sends_goal_outside_limits(commands):
    gate, bus, clock = make_gate_at(2048)
    for tick, elapsed_s in commands:
        clock.time_s += elapsed_s
        gate.update_measured({"elbow": min(max(tick, 900), 3100)}, clock.time_s)
        try:
            gate.send({"elbow": tick})
        except RefusedError:
            continue
    assert all(1000 <= goals[3] <= 3000 for goals in bus.sent)


def test_gate_checks_every_joint_before_it_sends_any():
    gate, bus, clock = make_gate_at(2048)
    with pytest.raises(RefusedError):
        gate.send({"wrist": 2050, "elbow": 3001})
    gate.send({"wrist": 2048 + 67})
    clock.time_s = 0.0
    assert (bus.sent, dict(gate.goals)) == ([{4: 2115}], {"elbow": 2048, "wrist": 2115})


def test_refused_command_does_not_use_up_allowed_step():
    gate, bus, clock = make_gate_at(2048)
    clock.time_s = 0.01
    gate.update_measured({"elbow": 2048}, 0.01)
    with pytest.raises(RefusedError):
        gate.send({"elbow": 2048 + 102})
    gate.send({"elbow": 2048 + 101})
    assert bus.sent == [{3: 2149}]


def test_goals_sent_at_same_time_share_one_allowed_step():
    gate, bus, _ = make_gate_at(2048)
    gate.send({"elbow": 2048 + 101})
    gate.send({"elbow": 2048 + 102})
    for tick in (2048 + 103, 2048 + 101):
        with pytest.raises(RefusedError, match="step of 1 ticks in 0 ms for elbow \\(max 0\\)"):
            gate.send({"elbow": tick})
    gate.send({"elbow": 2048 + 102})
    assert [goals[3] for goals in bus.sent] == [2149, 2150, 2150]


def test_gate_limits_step_back_like_step_forward():
    gate, bus, _ = make_gate_at(2048)
    gate.update_measured({"elbow": 1948}, 0.02)
    gate.send({"elbow": 2048 - 201})
    with pytest.raises(RefusedError, match="step of 1 ticks"):
        gate.send({"elbow": 2048 - 202})
    assert bus.sent == [{3: 1847}]


def test_gate_refuses_goal_one_tick_beyond_max_lead():
    gate, bus, clock = make_gate_at(2048)
    clock.time_s = 0.04
    gate.update_measured({"elbow": 2048}, 0.04)
    with pytest.raises(RefusedError, match="139 ticks ahead of its position \\(max 138\\)"):
        gate.send({"elbow": 2048 + 139})
    gate.send({"elbow": 2048 + 138})
    assert bus.sent == [{3: 2186}]


def test_gate_allows_less_lead_in_slow_motion():
    gate, _, clock = make_gate_at(2048)
    clock.time_s = 0.04
    gate.update_measured({"elbow": 2048}, 0.04)
    gate.set_speeds({"elbow": 284 * 2 * math.pi / 4096})
    with pytest.raises(RefusedError, match="107 ticks ahead of its position \\(max 106\\)"):
        gate.send({"elbow": 2048 + 107})
    gate.set_speeds({})
    gate.send({"elbow": 2048 + 107})


def test_gate_refuses_goal_without_position_reading():
    bus = Recorder()
    gate = NamedGate([make_limits()], bus, ManualClock())
    gate.reset_goals({"elbow": 2048})
    with pytest.raises(RefusedError, match="No position reading from elbow"):
        gate.send({"elbow": 2048})
    assert bus.sent == [{3: 2048}]


@pytest.mark.parametrize(
    "call", ["pass_goals", "shorten_goals", "pass_reset", "pass_hold", "update_measured"]
)
@pytest.mark.parametrize("row", [[], [2048], [2048, 2048, None]])
def test_every_gate_method_refuses_array_of_wrong_length(call, row):
    gate, _, clock = make_gate_at(2048)
    times = (clock.now_s(),) if call in ("shorten_goals", "update_measured") else ()
    with pytest.raises(RefusedError, match="do not match the 2 joints"):
        getattr(gate.gate, call)(row, *times)


def test_gate_keeps_goal_of_joint_without_commands():
    gate, bus, _ = make_gate_at(2048)
    passes = gate.gate
    for passed in (
        passes.pass_goals([None, 2050]),
        passes.pass_reset([None, 2050]),
        passes.pass_hold([None, 2048]),
    ):
        assert passed.ticks[0] is None
        gate._write(passed)
    assert [list(goals) for goals in bus.sent] == [[4], [4], [4]]
    assert gate.goals["elbow"] == 2048


def test_gate_counts_goals_as_sent_only_after_commit():
    gate, bus, _ = make_gate_at(2048)
    passed = gate.gate.pass_goals([2148, 2048])
    assert (dict(gate.goals), bus.sent) == ({"elbow": 2048, "wrist": 2048}, [])
    gate.gate.commit(passed)
    assert gate.goals["elbow"] == 2148


@pytest.mark.parametrize("call", ["update_measured", "set_speeds", "reset_goals", "hold"])
def test_every_gate_method_refuses_unknown_joint(call):
    gate, bus, _ = make_gate_at(2048)
    rest = (0.02,) if call == "update_measured" else ()
    with pytest.raises(RefusedError, match="3 values do not match the 2 joints"):
        getattr(gate, call)({"elbo": 2048}, *rest)
    assert bus.sent == []


def test_gate_returns_latest_measured_ticks():
    gate, _, _ = make_gate_at(2000)
    gate.update_measured({"elbow": 2010}, 0.03)
    assert gate.measured_ticks == {"elbow": 2010, "wrist": 2048}


def test_gate_advance_is_limited_by_slowest_joint_and_50_ms():
    gate, _, _ = make_gate_at(2048, speed_tick_s=100)
    assert gate.allowed_advance_s(0.03) == pytest.approx(0.013700, abs=1e-6)  # the wrist: 137 ticks
    gate.set_speeds({"wrist": 0.01})
    assert gate.allowed_advance_s(0.03) == 0.03
    assert gate.allowed_advance_s(7.0) == 0.05


# --- the stop that stays


def test_gate_accepts_only_hold_after_stop():
    gate, bus, _ = make_gate_at(2048)
    hot = StopReason(StopKind.FAULT, "elbow is too hot")
    gate.latch_stop(hot)
    for send in (gate.send, gate.reset_goals):
        with pytest.raises(RefusedError, match="arm was stopped: elbow is too hot"):
            send({"elbow": 2048})
    gate.hold({"elbow": 2048})
    assert (bus.sent, gate.stop_reason) == ([{3: 2048}], hot)


def test_acknowledged_gate_refuses_goals_until_reset_goals():
    gate, bus, _ = make_gate_at(2048)
    unplugged = StopReason(StopKind.UNPLUGGED, "the cable")
    gate.latch_stop(unplugged)
    assert gate.acknowledge() is unplugged
    assert gate.stop_reason is None
    with pytest.raises(RefusedError, match="The position of elbow has not been measured"):
        gate.send({"elbow": 2048})
    gate.reset_goals({"elbow": 1500})
    assert bus.sent == [{3: 1500}]


def test_acknowledging_gate_without_stop_keeps_goals():
    gate, bus, _ = make_gate_at(2048)
    assert gate.acknowledge() is None
    gate.send({"elbow": 2048})
    assert bus.sent == [{3: 2048}]


@pytest.mark.parametrize("tick", [2100, 2148, 2120])
def test_hold_is_accepted_between_measured_tick_and_goal(tick):
    gate, bus, _ = make_gate_at(2148)
    gate.update_measured({"elbow": 2100}, 0.02)
    gate.hold({"elbow": tick})
    assert (bus.sent, gate.goals["elbow"]) == ([{3: tick}], tick)


@pytest.mark.parametrize("tick", [2099, 2149])
@pytest.mark.parametrize("seen", [2100, 2148])
def test_hold_that_would_move_one_joint_is_refused_for_all(tick, seen):
    gate, bus, _ = make_gate_at(2100 if seen == 2148 else 2148)
    gate.update_measured({"elbow": seen}, 0.02)
    with pytest.raises(RefusedError, match=f"{tick} would move elbow"):
        gate.hold({"wrist": 2048, "elbow": tick})
    assert bus.sent == []


def test_hold_of_joint_below_limits_is_sent_as_limit():
    gate, bus, _ = make_gate_at(1010)
    gate.update_measured({"elbow": 980}, 0.02)
    gate.hold({"elbow": 980})
    assert bus.sent == [{3: 1000}]


def test_hold_of_unmeasured_joint_is_accepted_only_at_its_goal():
    bus = Recorder()
    gate = NamedGate([make_limits()], bus, ManualClock())
    gate.reset_goals({"elbow": 2048})
    with pytest.raises(RefusedError, match="2049 would move elbow"):
        gate.hold({"elbow": 2049})
    gate.hold({"elbow": 2048})
    assert bus.sent == [{3: 2048}, {3: 2048}]


@pytest.mark.parametrize("tick", [math.nan, 2048.0, "2048", True])
def test_hold_refuses_tick_that_is_not_an_integer(tick):
    gate, bus, _ = make_gate_at(2048)
    with pytest.raises(RefusedError, match="goal of elbow"):
        gate.hold({"elbow": tick})
    assert bus.sent == []


def test_allowed_step_time_restarts_after_hold():
    gate, _, clock = make_gate_at(2048)
    clock.time_s = 0.04
    gate.hold({"elbow": 2048})
    with pytest.raises(RefusedError, match="in 0 ms"):
        gate.send({"elbow": 2050})


# --- distant goals


@pytest.mark.parametrize(("goal", "start"), [(1000, 2000), (3000, 2000), (950, 950), (960, 950)])
def test_gate_range_check_accepts_goal_towards_limits(goal, start):
    make_gate_at(2048)[0].check_range({"elbow": goal}, {"elbow": start})


@pytest.mark.parametrize(("goal", "start"), [(999, 2000), (3001, 2000), (949, 950), (999.0, 2000)])
def test_gate_range_check_refuses_goal_outside_limits(goal, start):
    with pytest.raises(RefusedError):
        make_gate_at(2048)[0].check_range({"elbow": goal}, {"elbow": start})


def test_gate_range_check_refuses_unknown_joint():
    with pytest.raises(RefusedError, match="3 values do not match the 2 joints"):
        make_gate_at(2048)[0].check_range({"elbo": 2048}, {"elbo": 2048})


def test_gate_clamp_of_joint_outside_limits_is_its_position():
    assert make_gate_at(950)[0].clamp("elbow", 900) == 950


def test_gate_goals_mapping_is_read_only():
    gate, _, _ = make_gate_at(2048)
    with pytest.raises(TypeError):
        gate.gate.goals[0] = 4000


SLOW = 2000  # ticks/s: 40 in 20 ms and one of rounding, 101 in 50 ms


class TestOneReadingOfTheClock:
    def test_gate_checks_step_by_time_given_with_goal(self):
        gate, bus, clock = make_gate_at(2048, speed_tick_s=SLOW)
        clock.time_s = 5 * CYCLE_S  # held up since the reading
        gate.send({"elbow": 2048 + 40}, CYCLE_S)
        gate.send({"elbow": 2048 + 80}, 2 * CYCLE_S)
        assert bus.sent[-1] == {3: 2048 + 80}

    def test_time_used_by_one_step_does_not_count_for_next(self):
        gate, _, clock = make_gate_at(2048, speed_tick_s=SLOW)
        clock.time_s = 5 * CYCLE_S
        gate.send({"elbow": 2048 + 81}, 2 * CYCLE_S)
        with pytest.raises(RefusedError, match=r"setpoint step of 41 ticks in 20 ms .*max 40"):
            gate.send({"elbow": 2048 + 122}, 3 * CYCLE_S)

    @pytest.mark.parametrize("time_s", [CYCLE_S + 1e-6, -1e-6, math.nan, math.inf])
    def test_goal_time_after_now_or_before_last_command_is_refused(self, time_s):
        gate, bus, _ = make_gate_at(2048, speed_tick_s=SLOW)
        with pytest.raises(RefusedError, match=r"time of the goals, .* not between"):
            gate.send({"elbow": 2049}, time_s)
        assert bus.sent == []

    @pytest.mark.parametrize("time_s", [0.0, CYCLE_S])
    def test_goal_time_of_last_command_or_now_is_accepted(self, time_s):
        gate, bus, _ = make_gate_at(2048, speed_tick_s=SLOW)
        gate.send({"elbow": 2049}, time_s)
        assert bus.sent == [{3: 2049}]


class TestCut:
    @pytest.mark.parametrize("direction", [1, -1])
    def test_shorten_goals_keeps_step_that_gate_accepts(self, direction):
        gate, _, _ = make_gate_at(2048, speed_tick_s=SLOW)
        goals = {"elbow": 2048 + direction * 41}
        assert gate.shorten_goals(goals, CYCLE_S) == goals

    @pytest.mark.parametrize("direction", [1, -1])
    @pytest.mark.parametrize("step", [42, 60, 101])
    def test_shorten_goals_reduces_long_step_to_longest_allowed(self, step, direction):
        gate, bus, _ = make_gate_at(2048, speed_tick_s=SLOW)
        goals = gate.shorten_goals({"elbow": 2048 + direction * step}, CYCLE_S)
        assert goals == {"elbow": 2048 + direction * 41}
        gate.send(goals, CYCLE_S)
        assert bus.sent == [{3: 2048 + direction * 41}]

    def test_shorten_goals_shortens_all_joints_by_same_fraction(self):
        gate, _, _ = make_gate_at(2048, speed_tick_s=SLOW)
        assert gate.shorten_goals({"elbow": 2048 + 82, "wrist": 2048 - 41}, CYCLE_S) == {
            "elbow": 2048 + 41,
            "wrist": 2048 - 20,
        }

    @pytest.mark.parametrize("direction", [1, -1])
    def test_shorten_goals_reduces_step_to_maximum_lead(self, direction):
        gate, _, clock = make_gate_at(2048)  # fast
        gate.send({"elbow": 2048 + direction * 100}, CYCLE_S)
        clock.time_s = 2 * CYCLE_S
        goals = gate.shorten_goals({"elbow": 2048 + direction * 200}, 2 * CYCLE_S)
        assert goals == {"elbow": 2048 + direction * LEAD}
        gate.send(goals, 2 * CYCLE_S)

    @pytest.mark.parametrize("direction", [1, -1])
    def test_shorten_goals_holds_goal_beyond_maximum_lead(self, direction):
        gate, _, clock = make_gate_at(2048)  # fast
        gate.send({"elbow": 2048 + direction * 100}, CYCLE_S)
        clock.time_s = 2 * CYCLE_S
        gate.update_measured({"elbow": 2048 - direction * 100}, 2 * CYCLE_S)
        at = 2048 + direction * 100
        assert gate.shorten_goals({"elbow": at + direction * 9}, 2 * CYCLE_S) == {"elbow": at}
        assert gate.shorten_goals({"elbow": at - direction * 9}, 2 * CYCLE_S) == {
            "elbow": at - direction * 9
        }

    @pytest.mark.parametrize("direction", [1, -1])
    def test_shorten_goals_does_not_shorten_jump_beyond_50_ms(self, direction):
        gate, bus, _ = make_gate_at(2048, speed_tick_s=SLOW)
        assert gate.shorten_goals({"elbow": 2048 + direction * 101}, CYCLE_S) == {
            "elbow": 2048 + direction * 41
        }
        jump = {"elbow": 2048 + direction * 102}
        assert gate.shorten_goals(jump, CYCLE_S) == jump
        with pytest.raises(RefusedError, match="setpoint step of 102 ticks"):
            gate.send(jump, CYCLE_S)
        assert bus.sent == []

    @pytest.mark.parametrize("tick", [3001, 3300])
    def test_shorten_goals_refuses_goal_outside_limits(self, tick):
        gate, _, _ = make_gate_at(2990, speed_tick_s=SLOW)
        with pytest.raises(RefusedError, match="upper limit"):
            gate.shorten_goals({"elbow": tick}, CYCLE_S)

    def test_shorten_goals_keeps_goal_if_no_time_has_passed(self):
        gate, _, _ = make_gate_at(2048, speed_tick_s=SLOW)
        gate.send({"elbow": 2048 + 41}, CYCLE_S)
        assert gate.shorten_goals({"elbow": 2048 + 60}, CYCLE_S) == {"elbow": 2048 + 41}

    def test_shorten_goals_drops_one_tick_step_if_no_time_has_passed(self):
        gate, _, _ = make_gate_at(2048, speed_tick_s=SLOW)
        gate.send({"elbow": 2048 + 41}, CYCLE_S)
        assert gate.shorten_goals({"elbow": 2048 + 42}, CYCLE_S) == {"elbow": 2048 + 41}

    def test_shorten_goals_ignores_resting_joint(self):
        gate, _, _ = make_gate_at(2048, speed_tick_s=SLOW)
        goals = {"elbow": 2048 + 40, "wrist": 2048}
        assert gate.shorten_goals(goals, CYCLE_S) == goals

    def test_shorten_goals_of_empty_command_is_empty(self):
        gate, _, _ = make_gate_at(2048, speed_tick_s=SLOW)
        assert gate.shorten_goals({}, CYCLE_S) == {}

    @pytest.mark.parametrize("goal", [{"elbo": 2048}, {"elbow": 2048.5}, {"elbow": True}])
    def test_shorten_goals_refuses_unknown_joint_and_float(self, goal):
        gate, _, _ = make_gate_at(2048, speed_tick_s=SLOW)
        with pytest.raises(RefusedError):
            gate.shorten_goals(goal, CYCLE_S)

    def test_shorten_goals_refuses_joint_without_recent_reading(self):
        gate, _, clock = make_gate_at(2048, speed_tick_s=SLOW)
        clock.time_s = CYCLE_S + 0.26
        with pytest.raises(RefusedError, match="No position reading from elbow"):
            gate.shorten_goals({"elbow": 2050}, clock.time_s)


def test_joint_without_reading_for_250_ms_is_stale():
    gate, _, clock = make_gate_at(2048, speed_tick_s=SLOW)
    assert gate.stale_joints(CYCLE_S + 0.25) == ()
    gate.update_measured({"wrist": 2048}, CYCLE_S + 0.1)
    assert gate.stale_joints(CYCLE_S + 0.2501) == ("elbow",)
    assert NamedGate([make_limits()], Recorder(), clock).stale_joints(0.0) == ("elbow",)


def test_check_stop_raises_only_while_stop_is_latched():
    gate, _, _ = make_gate_at(2048)
    gate.check_stop()
    gate.latch_stop(StopReason(StopKind.PROGRAM, "enough"))
    with pytest.raises(RefusedError, match="enough"):
        gate.check_stop()
    gate.acknowledge()
    gate.check_stop()
