"""Typed and stepped targets in virtual time move only what they name."""

import math

import numpy as np
import pytest

from ikservo.apps.page.messages import page_messages
from ikservo.apps.page.messages.page_messages import BadMessageError
from tests.apps.page.view_session import ViewSession
from tests.arm.simulated import registers, servo_id, true_joints, true_tip_m


@pytest.fixture
def session():
    with ViewSession() as session:
        yield session


def degrees(session, joint):
    return math.degrees(true_joints(session.arm)[joint])


def goal_of(session, joint):
    return session.interaction.goal[session.arm.joint_index.column(joint)]


@pytest.mark.full
@pytest.mark.sample(1)
@pytest.mark.parametrize(("joint", "value"), [("wrist_roll", 25.0), ("gripper", 12.0)])
def test_typed_joint_value_moves_only_that_joint_in_live_mode(session, joint, value):
    session.enable_live()
    before = true_joints(session.arm)
    session.send_message(page_messages.SetJoint, joint=joint, value=value)
    session.run(cycles=600)
    assert degrees(session, joint) == pytest.approx(value, abs=0.5)
    for name, at in true_joints(session.arm).items():
        if name != joint:
            assert abs(at - before[name]) < math.radians(1.0)


def test_typed_joint_value_moves_only_goal_in_preview_mode(session):
    before = registers(session.arm, "goal_position")
    session.send_message(page_messages.SetJoint, joint="wrist_roll", value=25.0)
    session.run()
    assert registers(session.arm, "goal_position") == before
    assert math.degrees(goal_of(session, "wrist_roll")) == pytest.approx(25.0)


@pytest.mark.sample(3)
@pytest.mark.parametrize(
    ("message", "fields", "words"),
    [
        (page_messages.SetJoint, {"joint": "elbow_flex", "value": 120.0}, "it goes from -96.8"),
        (page_messages.SetJoint, {"joint": "elbow", "value": 1.0}, "no joint"),
        (page_messages.JogJoint, {"joint": "elbow", "step": 1.0}, "no joint"),
        (page_messages.SetTool, {"what": "x", "value": 900.0}, "cannot be reached"),
        (page_messages.SetTool, {"what": "pitch", "value": 100.0}, "at most ±90"),
        (page_messages.PointTool, {"direction": [0.0, 0.0, 0.0]}, "has no length"),
        (page_messages.SetTorque, {"joint": "elbow", "on": False}, "no joint"),
    ],
)
def test_impossible_typed_target_is_refused(session, message, fields, words):
    session.send_message(page_messages.SetJoint, joint="wrist_roll", value=25.0)
    goal = session.interaction.goal
    with pytest.raises(BadMessageError, match=words):
        session.send_message(message, **fields)
    assert session.interaction.goal is goal


def test_joint_step_buttons_stop_at_joint_limit(session):
    session.send_message(page_messages.SetJoint, joint="elbow_flex", value=90.0)
    session.send_message(page_messages.JogJoint, joint="elbow_flex", step=5.0)
    assert math.degrees(goal_of(session, "elbow_flex")) == pytest.approx(95.0)
    session.send_message(page_messages.JogJoint, joint="elbow_flex", step=5.0)
    upper = session.arm.limits()[1][session.arm.joint_index.column("elbow_flex")]
    assert goal_of(session, "elbow_flex") == upper
    with pytest.raises(BadMessageError, match="elbow_flex cannot be at 101"):
        session.send_message(page_messages.JogJoint, joint="elbow_flex", step=5.0)


@pytest.mark.full
def test_tool_step_buttons_move_tip_along_one_axis(session):
    before_m = true_tip_m(session.arm)
    session.enable_live()
    for _ in range(4):
        session.send_message(page_messages.JogTool, what="z", step=5.0)
    session.run(cycles=600)
    moved_m = np.array(true_tip_m(session.arm)) - before_m
    assert moved_m == pytest.approx([0.0, 0.0, 0.02], abs=0.002)


def test_point_tool_down_button_keeps_tip_in_place(session):
    before_m = session.arm.chain.forward(session.arm.joint_index.chain_joints(
        session.arm_thread.snapshot.measured))[:3, 3]  # fmt: skip
    session.send_message(page_messages.PointTool, direction=[0.0, 0.0, -2.0])
    tool = session.latest_frames()["status"]["tool"]
    assert tool["pitch"] == pytest.approx(-90.0, abs=0.6)
    assert [tool[axis] for axis in "xyz"] == pytest.approx(1000.0 * before_m, abs=0.2)


def test_torque_of_one_servo_is_switched_off_and_on_in_place(session):
    elbow = servo_id("so101", "wrist_roll")
    session.send_message(page_messages.SetTorque, joint="wrist_roll", on=False)
    session.arm_thread.step()
    torque = registers(session.arm, "torque_enable")
    assert [i for i, on in torque.items() if not on] == [elbow]
    before = session.ticks()
    session.send_message(page_messages.SetTorque, joint="wrist_roll", on=True)
    session.arm_thread.step()
    session.arm_thread.step()
    assert all(registers(session.arm, "torque_enable").values())
    assert abs(session.ticks()[elbow] - before[elbow]) <= 1
    reported = [entry.message for entry in session.arm_thread.snapshot.messages]
    assert reported == [
        f"Torque of wrist_roll switched {to} from the page." for to in ("off", "on")
    ]


def test_torque_cannot_be_switched_in_live_mode_or_after_stop(session):
    session.enable_live()
    with pytest.raises(BadMessageError, match="stays on while Live is on"):
        session.send_message(page_messages.SetTorque, joint="wrist_roll", on=False)
    session.send_message(page_messages.Stop)
    session.arm_thread.step()
    for kind, fields in [
        (page_messages.SetTorque, {"joint": "wrist_roll", "on": False}),
        (page_messages.SetJoint, {"joint": "wrist_roll", "value": 1.0}),
    ]:
        with pytest.raises(BadMessageError, match="stopped"):
            session.send_message(kind, **fields)
    assert all(registers(session.arm, "torque_enable").values())


def test_gripper_preview_opens_fully_and_is_drawn(session):
    for _ in range(40):
        session.clock.sleep_until(session.clock.now_s() + 0.05)
        session.send_message(page_messages.Gamepad, axes=[0, 0, 0, 0], grip=-1.0)
    gripper = session.arm.model.gripper
    assert goal_of(session, gripper.joint) == pytest.approx(gripper.open, abs=0.02)
    scene = session.latest_frames()["scene"]
    assert scene["goal"] != scene["measured"]
    assert scene["goal"] is not None
