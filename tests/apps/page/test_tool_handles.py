"""Handles of the tool in 3D: axes that an arm can turn about, and drags in true joints."""

import math

import numpy as np
import pytest

from ikservo.apps.page.dragging.tool_handles import ToolHandles
from ikservo.apps.page.messages import page_messages
from ikservo.arm import open_arm
from ikservo.kinematics.se3 import exp_so3, log_so3
from ikservo.model import load_model
from ikservo.model.tool import tool_frame
from tests.apps.page.view_session import ViewSession
from tests.arm.simulated import registers, true_joints

NEAR_M, NEAR_RAD = 0.004, math.radians(1.0)  # simulated arms sag


@pytest.fixture(params=["so101"])
def session(request):
    with ViewSession(open_arm(request.param, "sim:?pose=home")) as session:
        yield session


def drag(session, phase, shift=(0.0, 0.0, 0.0), turn=(0.0, 0.0, 0.0)):
    session.send_message(page_messages.DragTool, phase=phase, shift=shift, turn=turn)


def drag_by(session, shift=(0.0, 0.0, 0.0), turn=(0.0, 0.0, 0.0), count=20):
    """Drag the handles in steps, as a page sends them, and release them."""
    drag(session, "down")
    for i in range(1, count + 1):
        part = i / count
        drag(session, "move", tuple(part * x for x in shift), tuple(part * x for x in turn))
    drag(session, "up")


def true_pose(session):
    joints = true_joints(session.arm)
    return session.arm.chain.forward(np.array([joints[n] for n in session.arm.chain.names]))


def handle_axes(session):
    handles = ToolHandles(session.arm.chain, tool_frame(session.arm.model).approach_axis)
    joints = true_joints(session.arm)
    return handles.axes(np.array([joints[n] for n in session.arm.chain.names])), handles


@pytest.mark.parametrize(
    ("name", "moves", "turns"),
    [
        ("so101", [True, True, True], 2),
        ("wx250s", [True, True, True], 3),
        ("px100", [True, True, True], 1),
        ("planar3", [True, True, False], 1),
        ("planar2", [True, True, False], 0),
    ],
)
def test_tool_handles_match_degrees_of_freedom_of_arm(name, moves, turns):
    model = load_model(name)
    handles = ToolHandles(model.chain, tool_frame(model).approach_axis)
    assert handles.description == {"moves": moves, "turns": turns}


@pytest.mark.sample(1)
@pytest.mark.parametrize("session", ["so101", "wx250s", "px100"], indirect=True)
def test_ring_handle_turns_tool_about_its_axis_and_keeps_tip(session):
    session.enable_live()
    axes, handles = handle_axes(session)
    for axis in axes.T[: handles.description["turns"]]:
        before = true_pose(session)
        turn = math.radians(10.0) * axis
        drag_by(session, turn=tuple(turn.tolist()))
        session.run(cycles=400)
        after = true_pose(session)
        assert after[:3, 3] == pytest.approx(before[:3, 3], abs=NEAR_M)
        wanted = exp_so3(turn) @ before[:3, :3]
        assert np.linalg.norm(log_so3(wanted.T @ after[:3, :3])) < NEAR_RAD
        session.enable_live()


@pytest.mark.full
@pytest.mark.sample(1)
@pytest.mark.parametrize(
    ("session", "keeps_heading"), [("so101", False), ("wx250s", True)], indirect=["session"]
)
def test_arrow_handle_shifts_tip_and_keeps_pitch(session, keeps_heading):
    session.enable_live()
    before = true_pose(session)
    drag_by(session, shift=(0.0, 0.06, -0.02))
    session.run(cycles=500)
    after = true_pose(session)
    assert after[:3, 3] - before[:3, 3] == pytest.approx([0.0, 0.06, -0.02], abs=NEAR_M)
    tool = tool_frame(session.arm.model)
    pitch = [tool.pitch_rad(T[:3, :3]) for T in (before, after)]
    assert pitch[0] == pytest.approx(pitch[1], abs=NEAR_RAD)
    turned_rad = float(np.linalg.norm(log_so3(before[:3, :3].T @ after[:3, :3])))
    assert (turned_rad < NEAR_RAD) is keeps_heading


def test_tool_drag_in_preview_moves_nothing_and_is_one_undo_step(session):
    before = registers(session.arm, "goal_position")
    drag_by(session, shift=(0.0, 0.03, 0.0))
    session.run(cycles=20)
    assert registers(session.arm, "goal_position") == before
    assert session.interaction.goal is not None
    session.send_message(page_messages.Undo)
    assert session.interaction.goal is None


def test_tool_turn_past_joint_limits_is_reported(session):
    axes, _ = handle_axes(session)
    drag_by(session, turn=tuple((math.radians(150.0) * axes[:, 1]).tolist()))
    for _ in range(60):
        session.latest_frames()
    assert not session.interaction.marker.reached
    reported = session.interaction.messages[-1].message
    assert reported.startswith("The tool cannot have this orientation here (")


def test_tool_handle_without_press_or_after_stop_moves_nothing(session):
    drag(session, "move", shift=(0.0, 0.03, 0.0))
    assert session.interaction.goal is None
    drag(session, "down")
    session.send_message(page_messages.Stop)
    session.arm_thread.step()
    session.send_message(page_messages.Acknowledge)
    session.arm_thread.step()
    drag(session, "move", shift=(0.0, 0.03, 0.0))
    assert session.interaction.goal is None
