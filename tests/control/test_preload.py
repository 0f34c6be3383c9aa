"""Preload: gears are pressed to one side before a motion: which, how far, how long."""

from __future__ import annotations

import numpy as np
import pytest

import ikservo
from ikservo.control.goal_compensation import GoalCompensator
from ikservo.errors import StoppedError
from ikservo.guard import StopKind, StopReason
from ikservo.motion import TrajectoryPoint

CYCLE_S, TICK_RAD = 0.005, 2.0 * np.pi / 4096
PAN, LIFT = 0, 1


@pytest.fixture
def arm():
    with ikservo.open_arm("so101", port="sim:?pose=home") as opened:
        opened.enable()
        yield opened


def preload(compensator: GoalCompensator, start, ahead, measured_at=None, goals=None):
    """Preload joints for as long as they need; return the goals of all cycles (k, n)."""
    compensator.begin(start, start if goals is None else goals, CYCLE_S)
    at_rest, sent = TrajectoryPoint.at_rest(start), [start if goals is None else goals]
    for cycle in range(100):
        measured = start if measured_at is None else measured_at(cycle)
        if compensator.preload(ahead, measured, CYCLE_S):
            return np.array(sent)
        sent.append(compensator.goals(at_rest, CYCLE_S))
    pytest.fail("the motion never began")


def ways(joint, size=0.01):
    return size * np.eye(6)[joint]


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_preload_of_unloaded_joint_is_friction_plus_2_mrad(arm, side):
    compensator, start = arm._context.servos.compensator, arm._context.servos.reference()
    sent = preload(compensator, start, side * ways(PAN))
    low, high = compensator.stuck_offsets(start)
    friction = high[PAN] if side > 0.0 else low[PAN]
    assert sent[-1][PAN] - start[PAN] == pytest.approx(friction + side * 0.002, abs=1e-4)
    assert len(sent) * CYCLE_S == pytest.approx(0.2, abs=0.011)
    assert np.abs(np.diff(sent[:, PAN])).max() < 1.5 * TICK_RAD
    np.testing.assert_allclose(sent[-1][1:], start[1:], atol=1e-9)


def test_preload_does_not_wait_for_joint_pressed_by_weight(arm):
    compensator, start = arm._context.servos.compensator, arm._context.servos.reference()
    assert len(preload(compensator, start, ways(LIFT))) == 1


def test_preload_does_not_wait_for_joint_pressed_by_its_goal(arm):
    compensator, start = arm._context.servos.compensator, arm._context.servos.reference()
    _, high = compensator.stuck_offsets(start)
    goals = start + 0.5 * high * np.eye(6)[PAN]
    assert len(preload(compensator, start, ways(PAN), goals=goals)) == 1
    assert len(preload(compensator, start, -ways(PAN), goals=goals)) > 1


def test_preload_ends_when_joint_starts_to_move(arm):
    compensator, start = arm._context.servos.compensator, arm._context.servos.reference()

    def measured_at(cycle):
        return start + (cycle >= 10) * TICK_RAD * np.eye(6)[PAN]

    assert len(preload(compensator, start, ways(PAN), measured_at)) == 11


def test_preload_is_not_learned_as_friction(arm):
    compensator, start = arm._context.servos.compensator, arm._context.servos.reference()
    preload(compensator, start, ways(PAN))
    friction = []
    for cycle in range(100):
        way = 0.3 * cycle * CYCLE_S
        point = TrajectoryPoint(start + ways(PAN, way), ways(PAN, 0.3), np.zeros(6))
        compensator.goals(point, CYCLE_S)
        compensator.observe(point.position + ways(PAN, 0.003), 0.0, CYCLE_S, grow=1.0)
        friction.append(compensator._feedback.friction[PAN])
    assert friction[30] == 0.0
    assert friction[-1] < 0.0


def test_stop_during_preload_prevents_the_motion(arm):
    before = arm.where().positions["shoulder_pan"]
    clock, world = arm._context.port.clock, arm._context.port.transport.line.world
    plan = arm.plan_joints({"shoulder_pan": before + 0.5}, speed="fast")
    reason = StopReason(StopKind.PROGRAM)
    world.schedule(clock.now_s() + 0.05, lambda: arm.request_stop(reason))
    with pytest.raises(StoppedError):
        arm.execute(plan)
    assert abs(arm.where().positions["shoulder_pan"] - before) < 4 * TICK_RAD


def test_preload_does_not_learn_load_from_lagging_joint(arm):
    compensator, start = arm._context.servos.compensator, arm._context.servos.reference()
    compensator.begin(start, start, CYCLE_S)
    while not compensator.preload(ways(PAN), start, CYCLE_S):
        compensator.observe(start - ways(LIFT, 0.02), 0.0, CYCLE_S, grow=1.0)
        compensator.goals(TrajectoryPoint.at_rest(start), CYCLE_S)
    assert np.abs(compensator._feedback.integral).max() == 0.0
