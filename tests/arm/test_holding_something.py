"""With an object between its jaws an arm is lowered, followed and steered as without."""

import pytest

import ikservo
from tests.arm.simulated import motion_runner, registers, servo_id
from tests.arm.test_gripper import open_jaws, put_between


@pytest.fixture(params=["so101", pytest.param("koch", marks=pytest.mark.campaign)])
def holding(request):
    """Return an arm whose jaws have closed on an object, and its gripper's servo."""
    with ikservo.open_arm(request.param, port="sim:?pose=home") as arm:
        gripper = servo_id(request.param, "gripper")
        open_jaws(arm)
        put_between(arm, 0.4)
        assert arm.gripper("close").grasped
        yield arm, gripper


def lead(arm, gripper):
    return abs(
        registers(arm, "goal_position")[gripper] - registers(arm, "present_position")[gripper]
    )


@pytest.mark.full
def test_relax_works_with_grasped_object(holding):
    arm, _ = holding
    assert arm.relax().reached
    assert set(registers(arm, "torque_enable").values()) == {0}


@pytest.mark.full
@pytest.mark.parametrize("speed", [pytest.param("slow", marks=pytest.mark.campaign), "fast"])
def test_follow_does_not_press_grasped_object_harder(holding, speed):
    arm, gripper = holding
    before = lead(arm, gripper)
    arm.follow(
        [{arm.chain.names[0]: 0.2}] * int(2.0 / motion_runner(arm).loop.cycle_time_s), speed=speed
    )
    assert lead(arm, gripper) == pytest.approx(before, abs=2)
