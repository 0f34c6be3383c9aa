"""Targets are undone, redone and carried out by one button; the arm is lowered and relaxed."""

import math

import numpy as np
import pytest

from ikservo.apps.page.messages import page_messages
from ikservo.apps.page.messages.page_messages import BadMessageError
from ikservo.apps.page.server.auth import Permission
from tests.apps.page.view_session import ViewSession
from tests.arm.simulated import registers, true_joints


@pytest.fixture
def session():
    with ViewSession() as session:
        yield session


def roll(session):
    goal = session.interaction.goal
    column = session.arm.joint_index.column("wrist_roll")
    return None if goal is None else round(math.degrees(goal[column]), 3)


def pause(session):
    """Let enough time pass that the next action is a separate gesture."""
    session.clock.sleep_until(session.clock.now_s() + 1.0)


def set_roll(session, value):
    pause(session)
    session.send_message(page_messages.SetJoint, joint="wrist_roll", value=value)


def act(session, action, on_progress=None):
    """Start an action and let the arm thread carry it out, with heartbeats."""
    session.send_message(page_messages.Heartbeat, visible=True)
    if action == "execute":
        session.go_there()
    else:
        session.send_message(page_messages.ArmAction, action=action)
    arm_thread, reported = session.arm_thread, session.arm_thread.on_progress

    def tell(progress):
        session.send_message(page_messages.Heartbeat, visible=True)
        reported(progress)
        if on_progress:
            on_progress()

    arm_thread.on_progress = tell
    arm_thread.step()
    del arm_thread.on_progress


def test_goal_changes_are_undone_and_redone_one_by_one(session):
    for value in (10.0, 20.0, 30.0):
        set_roll(session, value)
    seen = []
    for redo in (False, False, False, True, True, True):
        session.send_message(page_messages.Undo, redo=redo)
        seen.append(roll(session))
    assert seen == [20.0, 10.0, None, 10.0, 20.0, 30.0]
    with pytest.raises(BadMessageError, match="nothing to redo"):
        session.send_message(page_messages.Undo, redo=True)
    session.send_message(page_messages.Undo)
    set_roll(session, 5.0)
    status = session.latest_frames()["status"]
    assert (status["undo"], status["redo"], status["target"]) == (True, False, True)


def test_slider_drag_and_arm_drag_are_one_undo_step_each(session):
    set_roll(session, 10.0)
    pause(session)
    for value in range(11, 20):
        session.send_message(page_messages.SetJoint, joint="wrist_roll", value=value)
        session.clock.sleep_until(session.clock.now_s() + 0.05)
    session.point("down", 700, 250)
    for x in (690, 680, 670):
        session.point("move", x, 250)
        pause(session)
    session.point("up", 670, 250)
    session.send_message(page_messages.Undo)
    assert roll(session) == 19.0
    session.send_message(page_messages.Undo)
    assert roll(session) == 10.0


@pytest.mark.campaign
def test_undo_in_live_mode_moves_arm_back(session):
    session.enable_live()

    def drive(number):
        if number == 20:
            session.send_message(page_messages.SetJoint, joint="wrist_roll", value=30.0)
        if number == 400:
            assert math.degrees(true_joints(session.arm)["wrist_roll"]) == pytest.approx(30, abs=1)
            session.send_message(page_messages.Undo)

    session.run(cycles=800, on_cycle=drive)
    assert math.degrees(true_joints(session.arm)["wrist_roll"]) == pytest.approx(0.0, abs=1.0)


@pytest.mark.full
def test_executed_goal_equals_previewed_goal(session):
    session.send_message(page_messages.SetSpeed, name="fast")
    set_roll(session, 35.0)
    session.send_message(page_messages.SetJoint, joint="gripper", value=50.0)
    session.send_message(page_messages.SetTool, what="z", value=110.0)
    goal = session.interaction.goal.copy()
    act(session, "execute")
    at = true_joints(session.arm)
    reached = np.array([at[name] for name in session.arm.joint_index.names])
    assert np.degrees(np.abs(reached - goal)).max() < 0.7
    assert session.arm_thread.snapshot.stop_notice is None
    assert session.arm_thread.job is None


def test_refused_or_missing_target_is_not_executed(session):
    before = registers(session.arm, "goal_position")
    with pytest.raises(BadMessageError, match="No target is shown"):
        session.send_message(page_messages.ArmAction, action="execute")
    session.send_message(page_messages.SetJoint, joint="shoulder_lift", value=90.0)
    session.send_message(page_messages.SetJoint, joint="elbow_flex", value=-20.0)
    with pytest.raises(BadMessageError, match="not shown yet"):
        session.send_message(page_messages.ArmAction, action="execute")
    assert session.planned()["status"]["refused"]
    with pytest.raises(BadMessageError, match="would touch"):
        session.go_there()
    assert registers(session.arm, "goal_position") == before


@pytest.mark.full
def test_stop_during_execute_holds_until_acknowledged(session):
    set_roll(session, 60.0)

    def stop():
        if math.degrees(true_joints(session.arm)["wrist_roll"]) > 15:
            session.send_message(page_messages.Stop)

    act(session, "execute", stop)
    assert math.degrees(true_joints(session.arm)["wrist_roll"]) < 40
    for message, fields in [
        (page_messages.ArmAction, {"action": "execute"}),
        (page_messages.ArmAction, {"action": "relax"}),
        (page_messages.Undo, {}),
    ]:
        with pytest.raises(BadMessageError, match="was stopped"):
            session.send_message(message, **fields)


@pytest.mark.full
def test_commanded_torque_off_is_not_reported_as_torque_loss(session):
    act(session, "release")
    assert not any(registers(session.arm, "torque_enable").values())
    session.arm_thread.step()
    session.arm.enable()
    session.arm_thread.step()
    act(session, "relax")
    assert not any(registers(session.arm, "torque_enable").values())
    session.arm_thread.step()
    reported = [entry.message for entry in session.arm_thread.snapshot.messages]
    assert reported == [
        "Torque of all servos switched off from the page.",
        "The arm was lowered to its rest pose; torque is off.",
    ]


@pytest.mark.parametrize("view", ["side", "top", "orbit"])
def test_zoom_keeps_point_under_pointer_and_fit_resets_view(session, view):
    controller, client = session.controller, session.controller._clients[session.client]
    session.send_message(page_messages.SetViewport, w=900, h=700, dpr=1, view=view)
    composer = controller._composer
    at = (300.0, 500.0)
    before, first = composer.camera(client), client.view
    place_m = before.unproject(np.array(at), before.depth_of(composer.extent.box_m.mean(axis=0)))
    session.send_message(page_messages.OrbitCamera, dx=0, dy=0, zoom=1.6, at=at)
    px, _ = composer.camera(client).project(place_m)
    assert px == pytest.approx(at, abs=0.5)
    assert client.view.zoom == pytest.approx(1.6)
    session.send_message(page_messages.FitView)
    assert client.view == first


def test_watcher_keeps_own_view_while_operator_drags_arm(session):
    watcher = session.connect(Permission.WATCH)
    session.send_message(page_messages.SetViewport, watcher, w=900, h=700, dpr=1, view="top")
    composer, clients = session.controller._composer, session.controller._clients
    own = composer.camera(clients[watcher]).fingerprint
    tip_px, _ = composer.camera(clients[session.client]).project(
        session.arm.chain.forward(
            session.arm.joint_index.chain_joints(session.arm_thread.snapshot.measured)
        )[:3, 3]
    )
    session.point("down", *tip_px)
    session.point("move", tip_px[0] + 20, tip_px[1])
    assert session.interaction.camera is not None
    assert composer.camera(clients[watcher]).fingerprint == own
    session.send_message(page_messages.OrbitCamera, watcher, dx=30, dy=0, zoom=1.5)
    assert composer.camera(clients[watcher]).fingerprint != own
    assert composer.camera(clients[session.client]) is session.interaction.camera
