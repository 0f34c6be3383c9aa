"""Two servos on one joint: the second is monitored like the first."""

import pytest

import ikservo
from ikservo.errors import ServoAlarmError
from servosim.faults import Fault
from tests.arm.simulated import line_of
from tests.oracle import arm_file

JOINT = next(joint for joint in arm_file("vx300s")["joints"] if joint.get("shadows"))
SHADOW = JOINT["shadows"][0]["id"]


@pytest.mark.full
@pytest.mark.sample(1)
@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ({"kind": "hot", "celsius": 79.0}, "is at 7. °C"),
        ({"kind": "reset", "count": 1}, "was reset"),
    ],
)
def test_fault_of_second_servo_stops_arm_and_names_joint(fault, words):
    with ikservo.open_arm("vx300s", port="sim:?pose=home") as arm:
        arm.move_joints({"waist": 0.1})
        line = line_of(arm)
        line.faults.add(Fault(id=SHADOW, at_s=line.world.time_s + 0.2, **fault))
        with pytest.raises(ServoAlarmError, match=words) as caught:
            arm.move_joints({"waist": -0.4}, speed="slow")
        assert f"{JOINT['name']} (servo {SHADOW})" in str(caught.value)


@pytest.mark.full
def test_both_servos_share_joint_load_despite_backlash():
    with ikservo.open_arm("wx250s", port="sim:?pose=home&backlash_deg=0.5") as arm:
        arm.move_joints({"shoulder": 0.6, "elbow": -0.6}, speed="fast")
        world = line_of(arm).world
        load_nm = world.body.load_nm([j.position for j in world.joints], [0.0] * 7)[1]
        lead, follower = (servo.motor for servo in world.joint("shoulder").servos)
        assert abs(load_nm) > 2.0
        assert lead.position_rad == follower.position_rad
        # the rest is friction
        held_nm = -(lead.torque_nm + follower.torque_nm)
        assert 0.5 < held_nm / load_nm < 1.7
