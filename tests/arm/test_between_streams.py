"""Stops and failures at moments at which no goal is streamed."""

import contextlib

import pytest

import ikservo
from ikservo.control.watchdog_and_torque_limits import ServoRamLimits
from ikservo.errors import BusError, RefusedError, StoppedError
from servosim.faults import Fault
from tests.arm.simulated import clock_of, line_of, registers, servo_group


@pytest.fixture(params=["so101", "koch"])
def arm(request):
    with ikservo.open_arm(request.param, port="sim:?pose=home", collisions=False) as machine:
        machine.move_joints({"shoulder_pan": 0.0})
        yield machine


def holds(arm):
    before = registers(arm, "present_position")
    with pytest.raises(RefusedError, match="was stopped"):
        arm.move_joints({"shoulder_pan": 0.8}, speed="fast")
    after = registers(arm, "present_position")
    return all(abs(after[i] - before[i]) <= 2 for i in before)


@pytest.mark.sample(1)
def test_stop_after_last_control_cycle_is_obeyed_and_arm_holds(arm, monkeypatch):
    disarm = ServoRamLimits.disarm_watchdog

    def stopped_meanwhile(limits):
        arm.stop("Stopped by another terminal.")
        disarm(limits)

    monkeypatch.setattr(ServoRamLimits, "disarm_watchdog", stopped_meanwhile)
    with pytest.raises(StoppedError, match="another terminal"):
        arm.move_joints({"shoulder_pan": 0.2})
    assert holds(arm)


@pytest.mark.full
@pytest.mark.sample(1)
def test_watchdog_stop_after_last_cycle_is_not_a_servo_reset(arm, monkeypatch):
    disarm, clock = ServoRamLimits.disarm_watchdog, clock_of(arm)

    def delayed(limits):
        clock.sleep_until(clock.now_s() + 0.3)  # the watchdogs of Dynamixel servos trip
        disarm(limits)

    arm.move_joints({"shoulder_lift": -0.3})
    with monkeypatch.context() as paused:
        paused.setattr(ServoRamLimits, "disarm_watchdog", delayed)
        arm.move_joints({"shoulder_lift": -0.2})
    arm.where()
    group, held = servo_group(arm), registers(arm, "goal_position")
    for driven, goal in zip(group.driven_joints, group.goals(), strict=True):
        assert held[driven.servo_id] == driven.tick(float(goal))
    assert arm.move_joints({"shoulder_lift": -0.3}).reached


@pytest.mark.sample(1)
def test_stop_between_parts_of_motion_raises_stopped_error(arm, monkeypatch):
    streaming, begun = servo_group(arm).streaming, []

    @contextlib.contextmanager
    def stopped_before_the_second(speed_rad_s, profile_rad_s=None):
        begun.append(speed_rad_s)
        if len(begun) == 2:
            arm.stop("Stopped by another terminal.")
        with streaming(speed_rad_s, profile_rad_s):
            yield

    monkeypatch.setattr(servo_group(arm), "streaming", stopped_before_the_second)
    with pytest.raises(StoppedError, match="another terminal") as caught:
        arm.move_joints({"shoulder_pan": 0.2})
    assert caught.value.exit_code == 130
    assert holds(arm)


@pytest.mark.full
@pytest.mark.sample(1)
def test_torque_state_is_read_again_after_failed_torque_off(arm):
    arm.pose("rest")
    world = line_of(arm).world
    line_of(arm).faults.add(Fault(kind="silent", id=6, at_s=world.time_s, for_s=0.6))
    with pytest.raises(BusError):
        arm.disable_torque()
    clock_of(arm).sleep_until(clock_of(arm).now_s() + 1.5)
    assert arm.move_joints({"wrist_roll": 0.1}).reached


def test_servo_watchdog_that_cannot_be_read_counts_as_tripped(monkeypatch):
    with ikservo.open_arm("koch", port="sim:?pose=home") as arm:
        arm.move_joints({"shoulder_pan": 0.0})
        limits = servo_group(arm)._limits
        limits.arm_watchdog()
        limits.check_watchdog_gap(0.2)

        def silent(*_, **__):
            raise BusError("nothing was heard")

        monkeypatch.setattr(servo_group(arm)._bus, "read", silent)
        with pytest.raises(RefusedError, match="watchdog stopped them"):
            limits.check_watchdog_gap(0.2)
