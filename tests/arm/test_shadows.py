"""Two servos on one joint: the second is watched as the first is."""

import pytest

import ikservo
from ikservo.errors import ServoAlarmError
from servosim.faults import Fault
from tests.arm.simulated import line_of
from tests.oracle import arm_file

JOINT = next(joint for joint in arm_file("vx300s")["joints"] if joint.get("shadows"))
SHADOW = JOINT["shadows"][0]["id"]


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ({"kind": "hot", "celsius": 79.0}, "is at 7. °C"),
        ({"kind": "reset", "count": 1}, "was reset"),
    ],
)
def test_what_happens_to_the_second_servo_stops_the_arm_by_its_name(fault, words):
    with ikservo.open_arm("vx300s", port="sim:?pose=home") as arm:
        arm.move_joints({"waist": 0.1})
        line = line_of(arm)
        line.faults.add(Fault(id=SHADOW, at_s=line.world.time_s + 0.2, **fault))
        with pytest.raises(ServoAlarmError, match=words) as caught:
            arm.move_joints({"waist": -0.4}, speed="slow")
        assert f"{JOINT['name']} (servo {SHADOW})" in str(caught.value)
