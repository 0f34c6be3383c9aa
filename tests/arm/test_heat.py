"""An arm that is too hot holds, can be lowered, and finally lowers itself."""

from dataclasses import replace

import pytest

import ikservo
from ikservo.errors import RefusedError, ServoAlarmError
from servosim.faults import Fault
from tests.arm.simulated import line_of, registers, servo_group, true_joints

SHOULDER, HOT = 2, 3  # the elbow is hot


def opened(**limits):
    model = ikservo.load_model("so101")
    model = replace(model, health=replace(model.health, **limits))
    return ikservo.open_arm(model, port="sim:?pose=home", collisions=False)


def overheat(arm, celsius):
    arm.pose("home")
    line = line_of(arm)
    line.faults.add(Fault(kind="hot", id=HOT, celsius=celsius, at_s=line.world.time_s + 0.2))
    with pytest.raises(ServoAlarmError, match="elbow_flex is at"):
        arm.move_joints({"shoulder_pan": 0.5})


def jam(arm, servo_id):
    arm.pose("home")
    line = line_of(arm)
    line.faults.add(Fault(kind="stuck", id=servo_id, at_s=line.world.time_s))


def limp(arm):
    return not any(registers(arm, "torque_enable").values())


@pytest.mark.full
def test_overheated_arm_holds_and_can_be_lowered():
    with opened() as arm:
        overheat(arm, 68.0)
        assert all(registers(arm, "torque_enable").values())
        arm.acknowledge()
        assert arm.relax().reached
        assert limp(arm)


@pytest.mark.full
def test_overheated_and_lowered_arm_does_not_move_until_cool():
    with opened() as arm:
        overheat(arm, 68.0)
        arm.acknowledge()
        arm.relax()
        with pytest.raises(ServoAlarmError, match="elbow_flex is at"):
            arm.pose("home")


@pytest.mark.full
def test_arm_too_hot_to_hold_lowers_itself_and_stays_stopped():
    with opened(release_c=66.5) as arm:
        overheat(arm, 69.0)
        assert limp(arm)
        rest = arm.model.pose("rest")
        assert true_joints(arm)["shoulder_pan"] == pytest.approx(rest["shoulder_pan"], abs=0.03)
        with pytest.raises(RefusedError, match="was stopped: elbow_flex is at"):
            arm.pose("home")


@pytest.mark.full
def test_hot_arm_that_cannot_be_lowered_holds_and_warns():
    with opened(release_c=66.5) as arm:
        warnings = []
        servo_group(arm).warn = warnings.append
        jam(arm, SHOULDER)
        overheat(arm, 69.0)
        assert all(registers(arm, "torque_enable").values())
        assert [words for words in warnings if "could not be lowered" in words]
