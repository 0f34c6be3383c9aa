"""The path that is checked for contact is the executed one, from the arm's position then."""

from dataclasses import replace

import numpy as np
import pytest

import ikservo
from ikservo.errors import RefusedError
from ikservo.model.arm_model import KeepOutBox
from tests.arm.simulated import line_of, servo_group

# A post where the tool passes when the base is turned from 0.31 rad to the right.
POST = KeepOutBox("the post", (0.205, 0.031, 0.0), (0.211, 0.037, 0.1))
TURNED_RAD = -0.305  # so101 counts turns to the right


def so101(*boxes, **options):
    return ikservo.open_arm(
        replace(ikservo.load_model("so101"), keep_out=boxes), port="sim:?pose=home", **options
    )


def goals(arm):
    return servo_group(arm).goals()


def turned(arm):
    """Move the arm behind the post: up, around it and down again."""
    home = {n: float(q) for n, q in arm.model.pose("home").items()}
    for joints in (
        {"shoulder_lift": home["shoulder_lift"] - 0.7},
        {"shoulder_pan": TURNED_RAD},
        {"shoulder_lift": home["shoulder_lift"]},
    ):
        arm.move_joints(joints, speed="fast")


@pytest.fixture
def at_home():
    with so101(POST) as arm:
        arm.move_joints({"shoulder_pan": -0.04}, speed="fast")  # so near that a plan is rebased
        yield arm


@pytest.mark.full
def test_plan_is_checked_again_if_arm_has_moved_since(at_home):
    plan = at_home.plan_joints({"shoulder_pan": 0.8}, speed="fast")
    turned(at_home)
    before = goals(at_home)
    with pytest.raises(RefusedError, match="would touch the post"):
        at_home.execute(plan)
    np.testing.assert_array_equal(goals(at_home), before)


def test_plan_still_free_of_collision_is_executed_after_move(at_home):
    plan = at_home.plan_joints({"shoulder_pan": 0.8}, speed="fast")
    at_home.move_joints({"shoulder_pan": 0.2}, speed="fast")
    at_home.execute(plan)
    pan = line_of(at_home).world.joint("shoulder_pan").position
    assert pan == pytest.approx(0.8, abs=0.01)


def test_plan_made_without_collision_check_is_checked_later():
    with so101(collisions=False) as arm:
        plan = arm.plan_joints({"shoulder_lift": 0.6}, speed="slow")
    with so101() as arm, pytest.raises(RefusedError, match="would touch the table"):
        arm.execute(plan)


def test_plan_of_another_scene_is_checked_in_current_scene():
    with so101() as arm:
        plan = arm.plan_joints({"shoulder_pan": -0.8}, speed="slow")
    with so101(POST) as arm, pytest.raises(RefusedError, match="would touch the post"):
        arm.execute(plan)


def test_plan_of_another_arm_is_refused():
    with ikservo.open_arm("px100", port="sim:?pose=home") as arm:
        plan = arm.plan_joints({"waist": 0.1})
    with so101() as arm, pytest.raises(RefusedError, match="The plan moves waist"):
        arm.execute(plan)


@pytest.mark.full
def test_opened_arm_ignores_later_changes_of_its_files(tmp_path, monkeypatch):
    source = ikservo.load_model("so101").path.parent
    for file in source.iterdir():
        (tmp_path / file.name).write_text(file.read_text())
    with ikservo.open_arm(tmp_path, port=f"sim:{tmp_path}/arm.toml?pose=home") as arm:
        floor = "\n[surroundings]\nfloor_m = -0.5\n"
        (tmp_path / "arm.toml").write_text((tmp_path / "arm.toml").read_text() + floor)
        (tmp_path / "arm.urdf").write_text("no robot")
        with pytest.raises(RefusedError, match="would touch the table"):
            arm.move_joints({"shoulder_lift": 0.6})
        assert arm.move_joints({"shoulder_pan": 0.1}).reached
