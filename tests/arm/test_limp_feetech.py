"""A limp arm stays limp despite any failure, although goals switch on these servos' torque."""

import pytest

import ikservo
from ikservo.control.stop_requests import STOPPED_BY_PROGRAM
from ikservo.errors import IkservoError, RefusedError, StoppedError
from servosim.faults import Fault
from tests.arm.simulated import clock_of, line_of, motion_runner


@pytest.fixture
def arm():
    with ikservo.open_arm("so101", port="sim:?pose=rest", collisions=False) as machine:
        yield machine


def torques(arm):
    clock_of(arm).sleep_until(clock_of(arm).now_s() + 0.05)  # what was sent has arrived
    servos = line_of(arm).world.servos
    return [s.drive.torque_on or s.read("torque_enable") != 0 for s in servos]


def test_torque_switched_off_by_a_callback_stays_off(arm):
    def let_go(progress):
        if progress.elapsed_s > 0.3:
            arm.disable_torque()

    with pytest.raises(StoppedError):
        arm.move_joints({"shoulder_pan": 0.5}, on_progress=let_go)
    assert torques(arm) == [False] * 6


@pytest.mark.sample(1)
@pytest.mark.parametrize("stop", ["stop", "hold_servos"])
def test_stop_does_not_switch_torque_of_limp_arm_on(arm, stop):
    arm.move_joints({"shoulder_pan": 0.1})
    arm.disable_torque()
    if stop == "stop":
        arm.stop()
    else:
        motion_runner(arm).stop_servos(STOPPED_BY_PROGRAM)
    assert torques(arm) == [False] * 6


@pytest.mark.parametrize("servo_id", [1, 6])
def test_torque_stays_off_in_all_servos_if_one_is_silent(arm, servo_id):
    servo = line_of(arm).servos[servo_id]
    goal = servo.table.by_name["goal_position"].address

    def fall_silent(address, _):
        if address == goal:
            now_s = clock_of(arm).now_s()
            line_of(arm).faults.add(Fault("silent", id=servo_id, at_s=now_s, for_s=0.5))

    servo.on_write = fall_silent
    with pytest.raises(IkservoError):
        arm.enable()
    servo.on_write = None
    others = [on for place, on in enumerate(torques(arm), 1) if place != servo_id]
    assert others == [False] * 5


def test_arm_with_servo_in_another_mode_stays_limp(arm):
    line_of(arm).servos[3].write("operating_mode", 1)
    with pytest.raises(RefusedError, match=r"elbow_flex .*its operating mode is 1"):
        arm.enable()
    assert torques(arm) == [False] * 6
