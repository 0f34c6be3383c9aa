"""Boundary-dense: the last value that passes and the first that does not, for every rule."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ikservo.calibration import JointMap, Limits
from ikservo.errors import ExitCode, RefusedError
from ikservo.guard import Fence, Gate

TICK = 2 * math.pi / 4096


class HandClock:
    time_s = 0.0

    def now_s(self):
        return self.time_s


class Recorder:
    """The bus behind the gate: everything that came through."""

    def __init__(self):
        self.sent = []

    def __call__(self, goals):
        self.sent.append(dict(goals))


def fence(name="elbow", servo_id=3, *, low=1000, high=3000, speed_tick_s=10_000):
    joint_map = JointMap.revolute(name, servo_id, 1, 2048, 4096)
    limits = Limits.of(name, joint_map.position(low), joint_map.position(high), "hand sweep")
    return Fence(joint_map, limits, speed_tick_s * TICK)


def gate_at(tick, **kwargs):
    bus, clock = Recorder(), HandClock()
    gate = Gate([fence(**kwargs), fence("wrist", 4)], bus, clock)
    gate.start_from({"elbow": tick, "wrist": 2048})
    bus.sent.clear()
    clock.time_s = 0.02
    return gate, bus, clock


@pytest.mark.parametrize(("start", "tick"), [(1010, 1000), (2990, 3000), (1000, 1000)])
def test_the_last_tick_inside_the_limits_passes(start, tick):
    gate, bus, _ = gate_at(start)
    gate.send({"elbow": tick})
    assert bus.sent == [{3: tick}]


@pytest.mark.parametrize(("start", "tick"), [(1010, 999), (2990, 3001)])
def test_the_first_tick_outside_is_refused_and_nothing_is_sent(start, tick):
    gate, bus, _ = gate_at(start)
    with pytest.raises(RefusedError) as caught:
        gate.send({"wrist": 2050, "elbow": tick})
    assert caught.value.exit_code == ExitCode.REFUSED
    assert bus.sent == []


def test_a_refusal_names_the_joint_the_goal_the_limit_and_its_source():
    gate, _, _ = gate_at(2990)
    with pytest.raises(RefusedError, match=r"elbow would .* 83\.8°, past 83\.7° \(hand sweep\)"):
        gate.send({"elbow": 3001})


@pytest.mark.parametrize("direction", [1, -1])
def test_a_step_as_long_as_the_speed_allows_passes(direction):
    gate, bus, _ = gate_at(2048)
    gate.send({"elbow": 2048 + direction * 201})  # 10 000 ticks/s, 20 ms, and one of rounding
    assert bus.sent == [{3: 2048 + direction * 201}]


@pytest.mark.parametrize("direction", [1, -1])
def test_a_step_one_tick_longer_is_refused(direction):
    gate, bus, _ = gate_at(2048)
    with pytest.raises(RefusedError, match="elbow would have to jump 202 ticks in 20 ms"):
        gate.send({"elbow": 2048 + direction * 202})
    assert bus.sent == []


def test_after_a_stall_the_next_step_is_no_longer_than_after_50_ms():
    gate, _, clock = gate_at(2048)
    clock.time_s = 5.0
    with pytest.raises(RefusedError, match="in 50 ms, more than 501"):
        gate.send({"elbow": 2048 + 502})
    gate.send({"elbow": 2048 + 501})


def test_steps_are_counted_from_the_last_goal_that_passed():
    gate, bus, clock = gate_at(2048)
    gate.send({"elbow": 2248})
    clock.time_s = 0.04
    gate.send({"elbow": 2448})
    assert [goal[3] for goal in bus.sent] == [2248, 2448]


@pytest.mark.parametrize(("start", "inwards", "outwards"), [(950, 960, 949), (3050, 3040, 3051)])
def test_a_joint_outside_its_limits_may_come_back_but_not_go_further(start, inwards, outwards):
    gate, bus, clock = gate_at(start)
    with pytest.raises(RefusedError):
        gate.send({"elbow": outwards})
    gate.send({"elbow": inwards})
    clock.time_s = 0.04
    with pytest.raises(RefusedError):
        gate.send({"elbow": start})
    assert bus.sent == [{3: inwards}]


@pytest.mark.parametrize(
    "tick", [math.nan, math.inf, 2048.0, "2048", None, True, np.float64(2048), [2048]]
)
def test_a_goal_that_is_no_whole_number_is_refused_for_all_joints(tick):
    gate, bus, _ = gate_at(2048)
    with pytest.raises(RefusedError, match="goal of elbow"):
        gate.send({"wrist": 2050, "elbow": tick})
    assert bus.sent == []


def test_an_unknown_joint_is_refused_for_all_joints():
    gate, bus, _ = gate_at(2048)
    with pytest.raises(RefusedError, match="no joint 'elbo'"):
        gate.send({"wrist": 2050, "elbo": 2048})
    assert bus.sent == []


def test_nothing_passes_before_somebody_has_measured_where_the_joint_is():
    bus = Recorder()
    gate = Gate([fence()], bus, HandClock())
    with pytest.raises(RefusedError, match="Nobody has measured where elbow is"):
        gate.send({"elbow": 2048})
    assert bus.sent == []


def test_starting_sends_the_measured_ticks_as_goals_even_outside_the_limits():
    bus = Recorder()
    Gate([fence()], bus, HandClock()).start_from({"elbow": 950})
    assert bus.sent == [{3: 950}]


@pytest.mark.parametrize("tick", [math.nan, 2048.0, None])
def test_starting_from_no_whole_number_is_refused(tick):
    bus = Recorder()
    with pytest.raises(RefusedError):
        Gate([fence()], bus, HandClock()).start_from({"elbow": tick})
    assert bus.sent == []


@pytest.mark.parametrize(("tick", "nearest"), [(999, 1000), (3001, 3000), (1700, 1700)])
def test_the_nearest_tick_that_may_pass_is_on_the_limit(tick, nearest):
    gate, _, _ = gate_at(2048)
    assert gate.nearest("elbow", tick) == nearest


@given(st.lists(st.tuples(st.integers(-200, 4400), st.floats(0, 0.2)), max_size=30))
def test_whatever_is_asked_no_goal_outside_the_limits_is_ever_sent(commands):
    gate, bus, clock = gate_at(2048)
    for tick, elapsed_s in commands:
        clock.time_s += elapsed_s
        try:
            gate.send({"elbow": tick})
        except RefusedError:
            continue
    assert all(1000 <= goals[3] <= 3000 for goals in bus.sent)
