"""The stream of goals: steady, braked on demand, slow after a stall, stopped by failures."""

import time

import numpy as np
import pytest

import ikservo
from ikservo import control
from ikservo.control.loop import ControlLoop, TimeScaler
from ikservo.control.servo_group import ServoGroup
from ikservo.errors import RefusedError, StoppedError
from ikservo.guard import StopKind, StopReason
from ikservo.motion import JointMove, KinematicLimits
from servosim.faults import Fault
from tests.arm.audit import Auditor
from tests.arm.line_tracing import FailingLine, LineTracer
from tests.arm.simulated import clock_of, line_of, registers, servo_group

pytestmark = pytest.mark.smoke

CREEP_TICKS = 5  # of a joint at rest under its load
ENOUGH = StopReason(StopKind.PROGRAM, "enough")


@pytest.fixture
def arm():
    with ikservo.open_arm("so101", port="sim", collisions=False) as machine:
        machine.enable()
        yield machine


@pytest.fixture(params=["so101", "koch"])
def either(request):
    """Return an arm of each family."""
    with ikservo.open_arm(request.param, port="sim", collisions=False) as machine:
        machine.enable()
        yield machine


def course_of(servos: ServoGroup, way_rad=0.6, speed_rad_s=1.0):
    start = servos.goals()
    goal = start.copy()
    goal[0] += way_rad
    return JointMove(start, goal, [KinematicLimits(speed_rad_s, 3.0, 30.0)] * len(start))


def test_control_loop_runs_trajectory_to_its_end(either):
    course = course_of(servo_group(either))
    measured = ControlLoop(servo_group(either)).run(course, speed_rad_s=1.0)
    np.testing.assert_allclose(measured, course.goal, atol=0.16)


def test_control_loop_keeps_its_rate_and_motion_duration(arm):
    stream, cycles = ControlLoop(servo_group(arm)), []
    stream.run(course_of(servo_group(arm)), cycles.append)
    times = [cycle.time_s for cycle in cycles]
    assert times == sorted(times)
    assert np.median(np.diff(times)) == pytest.approx(stream.cycle_time_s, rel=0.2)
    assert times[-1] == cycles[-1].duration_s


def test_control_loop_rate_is_between_100_and_500_hz(either):
    assert 0.002 <= ControlLoop(servo_group(either)).measure_cycle_time_s() <= 0.010


def test_stop_request_brakes_within_300_ms_and_holds(either):
    stream, asked, clock = ControlLoop(servo_group(either)), [], clock_of(either)
    auditor = Auditor(either)

    def ask(cycle):
        if cycle.time_s > 0.4 and not asked:
            asked.append(clock.now_s())
            stream.request_stop(ENOUGH)

    with pytest.raises(StoppedError, match="enough"):
        stream.run(course_of(servo_group(either), 1.2), ask)
    assert clock.now_s() - asked[0] < 0.3
    assert all(registers(either, "torque_enable").values())
    assert auditor.faults() == []


def test_stop_brakes_for_a_quarter_of_a_second():
    throttle = TimeScaler(0.005)
    gaps = [throttle.step(0.005, braking=True) for _ in range(60)]
    assert gaps == sorted(gaps, reverse=True)
    assert sum(gap > 0 for gap in gaps) == pytest.approx(50, abs=1)


def test_stop_at_rest_refuses_the_next_motion(arm):
    before = registers(arm, "goal_position")
    arm.stop("wait")
    with pytest.raises(RefusedError, match="was stopped: wait"):
        arm.move_joints({arm.model.joints[0].name: 0.3})
    assert registers(arm, "goal_position") == before


def test_stop_of_control_loop_stays_until_acknowledged(arm):
    stream = ControlLoop(servo_group(arm))
    with pytest.raises(StoppedError):
        stream.run(course_of(servo_group(arm)), lambda _: stream.request_stop(ENOUGH))
    with pytest.raises(RefusedError, match="enough"):
        arm.move_joints({arm.model.joints[0].name: 0.3})
    arm.acknowledge()
    arm.move_joints({arm.model.joints[0].name: 0.3})


@pytest.mark.sample(1)
@pytest.mark.parametrize("stall_s", [0.06, 0.3, 5.0])
def test_goals_do_not_jump_after_control_loop_stall(stall_s):
    with ikservo.open_arm("so101", port="sim") as arm:
        arm.enable()
        auditor, clock, stalled = Auditor(arm), clock_of(arm), []

        def stall(cycle):
            if cycle.time_s > 0.3 and not stalled:
                stalled.append(clock.now_s())
                clock.sleep_until(clock.now_s() + stall_s)

        ControlLoop(servo_group(arm)).run(course_of(servo_group(arm)), stall)
        assert auditor.faults() == []
        steps = [abs(goal.tick - goal.last) for goal in auditor.goals_after(stalled[0] + 0.01)]
        assert max(steps) < 12


def test_watchdog_stop_after_late_control_loop_is_reported():
    with ikservo.open_arm("koch", port="sim") as arm:
        arm.enable()
        clock = clock_of(arm)
        with pytest.raises(RefusedError, match="so the servos' watchdog stopped them"):
            ControlLoop(servo_group(arm)).run(
                course_of(servo_group(arm)), lambda _: clock.sleep_until(clock.now_s() + 0.3)
            )


def test_motion_on_machine_that_is_always_late_is_refused():
    with ikservo.open_arm("so101", port="sim") as arm:
        arm.enable()
        clock = clock_of(arm)
        with pytest.raises(RefusedError, match="too busy"):
            ControlLoop(servo_group(arm)).run(
                course_of(servo_group(arm), speed_rad_s=0.05),
                lambda _: clock.sleep_until(clock.now_s() + 0.04),
            )


def test_motion_with_late_control_cycles_arrives_more_slowly(arm):
    clock, course, auditor = clock_of(arm), course_of(servo_group(arm), 1.5), Auditor(arm)
    begin_s = clock.now_s()
    measured = ControlLoop(servo_group(arm)).run(
        course, lambda _: clock.sleep_until(clock.now_s() + 0.04)
    )
    np.testing.assert_allclose(measured, course.goal, atol=0.16)
    assert clock.now_s() - begin_s > 1.5 * course.duration_s
    assert auditor.faults() == []


def test_wall_clock_steps_do_not_change_a_motion(arm, monkeypatch):
    hours = iter(range(10**9))
    monkeypatch.setattr(time, "time", lambda: 3600.0 * (-1) ** next(hours))
    course = course_of(servo_group(arm))
    measured = ControlLoop(servo_group(arm)).run(course)
    np.testing.assert_allclose(measured, course.goal, atol=0.16)


@pytest.mark.full
def test_goal_lead_is_bounded_by_look_ahead(arm):
    auditor = Auditor(arm)
    line_of(arm).servos[1].motor.grip = 0.3
    arm.move_joints({arm.model.joints[0].name: 1.0}, speed="fast")
    assert auditor.faults() == []


@pytest.mark.full
def test_control_loop_exception_leaves_arm_holding(arm):
    with LineTracer([control]) as traced:
        short_motion(arm, traced)
    lines = sorted(traced.hits)[::8]
    assert len(lines) > 10
    unreached = []  # the same motion does not wait for the same rotors twice
    for place in lines:
        arm.acknowledge()
        arm.enable()
        auditor = Auditor(arm)
        try:
            with FailingLine(place, max(1, traced.hits[place] // 2)) as failing:
                short_motion(arm, failing)
        except ZeroDivisionError:
            check_stopped(arm, auditor, place)
        else:
            unreached.append(place)
    assert len(unreached) <= len(lines) // 10


def short_motion(arm, traced):
    way_rad = 0.1 if servo_group(arm).goals()[0] < 0.0 else -0.1
    ControlLoop(servo_group(arm)).run(course_of(servo_group(arm), way_rad), traced.begin)


def check_stopped(arm, auditor, place):
    written, clock = len(auditor.goals), clock_of(arm)
    clock.sleep_until(clock.now_s() + 0.2)
    goals, servos = auditor.goals[written:], line_of(arm).servos
    assert {goal.servo_id for goal in goals} == set(servos), place
    assert len(goals) <= 3 * len(servos), place
    there = registers(arm, "present_position")
    clock.sleep_until(clock.now_s() + 0.2)
    later = registers(arm, "present_position")
    assert all(abs(later[i] - there[i]) <= CREEP_TICKS for i in servos), place
    assert auditor.faults() == [], place
    assert all(registers(arm, "torque_enable").values()), place


def test_stop_in_last_control_cycle_is_obeyed(arm):
    stream = ControlLoop(servo_group(arm))

    def ask(cycle):
        if cycle.time_s >= cycle.duration_s - 1.5 * stream.cycle_time_s:
            stream.request_stop(ENOUGH)

    with pytest.raises(StoppedError, match="enough"):
        stream.run(course_of(servo_group(arm)), ask)
    with pytest.raises(RefusedError, match="enough"):
        arm.move_joints({arm.model.joints[0].name: 0.3})


@pytest.mark.parametrize("what", ["hold", "enable", "relax"])
def test_hold_enable_and_relax_are_refused_during_a_motion(arm, what):
    with pytest.raises(RefusedError, match=r"^The arm is moving\."):
        arm.move_joints({arm.model.joints[0].name: 0.3}, on_progress=lambda _: getattr(arm, what)())
    assert all(registers(arm, "torque_enable").values())


def test_reply_lost_after_control_loop_stall_is_read_again(arm):
    stream, line, stalled = ControlLoop(servo_group(arm)), line_of(arm), []

    def stall(cycle):
        if cycle.time_s > 0.3 and not stalled:
            stalled.append(cycle)
            until_s = line.world.time_s + 0.4
            line.faults.add(Fault(kind="silent", id=6, at_s=until_s - 0.1, for_s=0.102))
            clock_of(arm).sleep_until(clock_of(arm).now_s() + 0.4)

    stream.run(course_of(servo_group(arm)), stall)
    assert stalled
