"""M1, M2: whatever a program requests, no goal outside limits reaches the line."""

import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import ikservo
from ikservo.errors import IkservoError, RefusedError
from tests.arm.seeds import few_or_many, log
from tests.arm.simulated import gate_of, line_of, servo_group
from tests.guard.gates import make_gate_at

WIDE = {"suppress_health_check": list(HealthCheck), "deadline": None}
NAMES = ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper"]

odd = st.one_of(
    st.sampled_from([math.nan, math.inf, -math.inf, 1e308, -1e308, 1e9, -0.0, 5e-324]),
    st.sampled_from([None, "0.2", "", b"1", (), [], {}, [0.1], True, object(), 1j]),
    st.sampled_from([np.float32("nan"), np.float64("inf"), np.array(math.nan), np.array([1.0, 2])]),
)
numbers = st.floats(-4.0, 4.0)


class Wire:
    """Counts the packets of the host, and keeps every goal of a servo."""

    def __init__(self, line):
        self.packets, self.goals = 0, {}
        for servo_id, servo in line.servos.items():
            servo.on_write = self._watcher(servo_id, servo.table.by_name["goal_position"])
        line.witnesses.append(self)

    def on_frame(self, at_s, frame, framing):
        self.packets += 1

    def on_reply(self, at_s, servo, data):
        pass

    def _watcher(self, servo_id, register):
        def watch(address, data):
            start = register.address - address
            if start >= 0 and start + register.size <= len(data):
                goal = register.decode(data[start : start + register.size])
                self.goals.setdefault(servo_id, []).append(goal)

        return watch


@pytest.fixture(scope="module")
def arm():
    with ikservo.open_arm("so101", port="sim") as machine:
        machine.enable()
        yield machine


@pytest.fixture(scope="module")
def wire(arm):
    return Wire(line_of(arm))


def inside(arm, goals):
    ranges = {driven.servo_id: driven.tick_range for driven in servo_group(arm).driven_joints}
    return all(
        ranges[servo_id][0] <= tick <= ranges[servo_id][1]
        for servo_id, ticks in goals.items() for tick in ticks
    )  # fmt: skip


def sent_goals(ask):
    """Return whether an entry point refused the request with one of our errors."""
    try:
        ask()
    except IkservoError:
        return True
    return False


# Each joint's own limits, one step inside and outside, and what is no position at all.
@settings(max_examples=80, **WIDE)
@given(st.sampled_from([*NAMES[:4], "", "elbow", None]), st.one_of(odd, st.floats()))
def test_refused_joint_goal_does_not_send_packets(arm, wire, name, position):
    before = wire.packets
    refused = sent_goals(lambda: arm.plan_joints({name: position, "wrist_roll": 0.1}))
    assert wire.packets == before
    assert refused or -4.0 < float(position) < 4.0


@settings(max_examples=40, **WIDE)
@given(st.one_of(odd, st.lists(st.one_of(odd, numbers), max_size=4)))
def test_refused_point_does_not_send_packets(arm, wire, point):
    before = wire.packets
    refused = sent_goals(lambda: arm.plan_to(point))
    assert wire.packets == before
    assert refused or np.shape(np.asarray(point, dtype=float)) == (3,)


@settings(max_examples=40, **WIDE)
@given(st.dictionaries(st.sampled_from(NAMES), st.one_of(odd, numbers), max_size=6))
def test_gate_sends_goals_of_all_joints_or_none(arm, wire, asked):
    """Ticks of any kind for any joints are sent to the gate itself."""
    gate, before = gate_of(arm), wire.packets
    ticks = {n: v if not isinstance(v, float) else round(v, 3) for n, v in asked.items()}
    row = [ticks.get(name) for name in servo_group(arm).names]
    refused = sent_goals(lambda: servo_group(arm)._send(gate.pass_goals(row)))
    assert refused or all(tick is None for tick in row)
    assert wire.packets == before


@pytest.mark.parametrize("side", ["lower", "upper"])
@pytest.mark.parametrize("name", NAMES)
def test_goal_one_tick_beyond_limit_does_not_send_packets(arm, wire, name, side):
    driven = next(driven for driven in servo_group(arm).driven_joints if driven.joint == name)
    edge = driven.position_range[0 if side == "lower" else 1]
    outwards = -1 if side == "lower" else 1
    before = wire.packets
    assert sent_goals(
        lambda: arm.move_joints({name: edge + outwards * driven.joint_map.unit_per_tick})
    )
    assert wire.packets == before
    assert inside(arm, wire.goals)


def storm(count, seed):
    """Send random goals from a random program to a joint that lags and is pushed.

    Returns:
        The number of accepted goals, and of those that broke a rule, by arithmetic of this test.
    """
    random = np.random.default_rng(seed)
    gate, bus, clock = make_gate_at(2048)
    measured = seen = last = 2048
    passed = wrong = 0
    fresh_s = clock.time_s
    for setpoint, kind, elapsed_s, stalls in zip(
        random.normal(0.0, 120.0, count), random.integers(0, 12, count),
        random.uniform(0.0, 0.03, count), random.random(count) < 0.01, strict=True,
    ):  # fmt: skip
        clock.time_s += float(elapsed_s) + (4.0 if stalls else 0.0)
        measured += int(0.5 * (last - measured)) + int(random.integers(-3, 4))
        if kind != 1:
            gate.update_measured({"elbow": measured}, clock.time_s)
            seen, fresh_s = measured, clock.time_s
        goal = (math.nan, int(random.integers(-9999, 9999)))[kind - 2] if kind in (2, 3) else (
            int(last + 0.3 * setpoint))  # fmt: skip
        try:
            gate.send({"elbow": goal})
        except RefusedError:
            continue
        passed += 1
        wrong += not 1000 <= goal <= 3000
        wrong += abs(goal - seen) > max(138, abs(last - seen))
        wrong += clock.time_s - fresh_s > 0.25
        last = goal
    steps = np.abs(np.diff([2048, *(goals[3] for goals in bus.sent)]))
    wrong += len(bus.sent) != passed
    wrong += int((steps > 10_000 * 0.05 + 1).sum())
    return passed, wrong


@few_or_many(1, 1000)
def test_random_commands_never_break_gate_rules(seeds, capsys):
    found = [storm(10_000, seed) for seed in seeds]
    passed, wrong = (sum(column) for column in zip(*found, strict=True))
    log(capsys, f"{10_000 * len(seeds):,} commands: {passed:,} passed, {wrong} against a law")
    assert passed > 2000
    assert wrong == 0
