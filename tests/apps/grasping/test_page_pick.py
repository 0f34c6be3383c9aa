"""Picks that a page offers: searched for elsewhere, shown, withdrawn, carried out as shown."""

import math
import re
import threading
import time
from dataclasses import replace

import numpy as np
import pytest

import ikservo
from ikservo.apps.page.dragging.snapshot import StopNotice
from ikservo.apps.page.messages import page_messages as msg
from ikservo.apps.page.messages import program_messages
from ikservo.apps.page.messages.page_messages import BadMessageError
from ikservo.apps.page.panels.camera_view import CameraView
from ikservo.apps.page.panels.motion_offer import HEADING
from ikservo.apps.page.running.arm_job import ExecutePath
from ikservo.apps.page.server.auth import Permission
from ikservo.guard import StopKind, StopReason
from tests.apps.grasping.pick_session import pick_session
from tests.apps.page.view_session import ViewSession

pytest.importorskip("cv2")
pytest.importorskip("mujoco")

from tests.apps.cameras.saved_camera import save_simulated_camera

CUBE, GOAL = (0.24, 0.05, 0.0175), (0.22, -0.08, 0.0)


@pytest.fixture
def session(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    port = "sim:?pose=home&board=0&physics=1&cubes=red@0.24,0.05"
    with ikservo.open_arm("so101", port) as arm:
        save_simulated_camera(arm)
        with pick_session(arm) as session:
            yield session


@pytest.fixture
def slow_search(session, monkeypatch):
    """Return an event without which no search in the picture ends."""
    event = threading.Event()
    find = CameraView.block_finder

    def block_finder(view, px=None):
        found = find(view, px)

        def wait():
            assert threading.current_thread() is not threading.main_thread()
            event.wait(60.0)
            return found()

        return wait

    monkeypatch.setattr(CameraView, "block_finder", block_finder)
    yield event
    event.set()


def cube_m(session):
    return session.arm.context.port.transport.line.world.cube_poses()[0][:3, 3]


def refused(session, text, **message):
    with pytest.raises(BadMessageError, match=text):
        session.send_message(**message)


def test_page_lifts_clicked_cube_and_places_it_at_second_click(session):
    number = session.offered(CUBE)
    size, place = r"3\d x 3\d x 3\d mm", r"\(0\.2[34]\d, 0\.0[45]\d\) m"
    assert re.fullmatch(f"Pick up the red block, {size}, at {place}\\.", session.text)
    scene = session.shown["scene"]
    assert scene["path"]["number"] == number
    assert scene["goal"] is not None
    assert len(scene["swept"]) == 5
    assert session.arm_thread.command.goal is None
    session.go(number)
    assert cube_m(session)[2] > 0.06
    assert session.holds
    session.go(session.offered(GOAL))
    assert np.linalg.norm(cube_m(session)[:2] - GOAL[:2]) < 0.02
    assert not session.holds


def test_go_button_executes_exactly_the_shown_pick_plan(session):
    number, path = session.offered(CUBE), session.interaction.path
    shown = np.array([joints for joints, _ in path.postures])
    chain = ~session.arm.joint_index.outside_chain()
    streamed, on_progress = [], session.arm_thread.on_progress

    def record(progress):
        streamed.append(progress.setpoints_rad[chain].copy())
        on_progress(progress)

    session.arm_thread.on_progress = record
    session.go(number)
    away = np.abs(shown[:, None] - np.array(streamed)[None]).max(axis=2).min(axis=1)
    assert away.max() < math.radians(1.5)


def test_next_plan_begins_at_joints_measured_after_motion(session):
    session.offered(CUBE)
    servos = session.arm.context.servos

    def end_short(_arm, _on_progress):
        servos.set_reference(servos.reference() + 0.02)

    path = replace(session.interaction.path, run=end_short)
    ExecutePath(path).run(session.arm, session.arm_thread)
    chain = ~session.arm.joint_index.outside_chain()
    off_rad = (servos.reference() - servos.measure_positions())[chain]
    assert np.abs(off_rad).max() < 0.01


def test_joint_motion_within_backlash_keeps_pick_plan_valid(session):
    servos = session.arm.context.servos
    servos.set_reference(servos.reference() + 0.015)  # Go finds the joints where they are
    session.look()
    session.go(session.offered(CUBE))
    assert session.holds, session.texts


def test_empty_grasp_is_reported_and_page_returns_to_preview(session):
    number = session.offered(CUBE)
    data = session.arm.context.port.transport.line.world._mover._data
    data.qpos[-7:-5] = (-0.2, 0.2)  # somebody has taken the cube away
    session.go(number)
    assert any("found nothing at" in text for text in session.texts)
    assert session.shown["status"]["mode"] == "preview"
    assert not session.holds


def test_place_is_refused_with_old_picture_or_moved_camera(session, monkeypatch):
    session.go(session.offered(CUBE))
    session.cameras.video.is_fresh = False
    refused(session, "too old", kind=msg.Grasp, at=session.pixel(GOAL))
    session.cameras.video.is_fresh = True
    monkeypatch.setattr(CameraView, "change", "The camera has moved.")
    refused(session, "camera has moved", kind=msg.Grasp, at=session.pixel(GOAL))
    assert session.look()["scene"]["path"] is None
    assert session.offer is None
    assert session.holds


def test_pick_is_refused_while_gripper_holds_an_object(session):
    session.send_message(msg.Grasp)
    session.until(lambda: session.panel and session.panel["buttons"], "a list")
    button = session.panel["buttons"][0]
    session.go(session.offered(CUBE))
    session.send_message(msg.Grasp)
    session.look()
    assert session.text == "Click where to put it down."
    assert session.offer is None
    refused(session, "holds something", kind=msg.RunPanelMotion, heading=HEADING, button=button)
    assert session.holds


WITHDRAWALS = {
    "stop": lambda s: s.controller.stop("Test"),
    "stop of another program": lambda s: s.arm.request_stop(
        StopReason(StopKind.PROGRAM, "By another program.")
    ),
    "fault": lambda s: s.arm_thread._end_session(StopNotice("A servo does not answer.")),
    "acknowledge": lambda s: s.send_message(msg.Acknowledge),
    "live": lambda s: s.send_message(msg.SetLive, on=True),
    "other control": lambda s: s.send_message(msg.TakeControl, s.connect(), on=True),
    "no control": lambda s: (
        s.send_message(msg.TakeControl, on=False), s.send_message(msg.TakeControl, on=True)),
    "torque off": lambda s: (
        s.send_message(msg.SetTorque, joint="gripper", on=False)),
    "torque lost": lambda s: s.arm.runner.set_joint_torque("gripper", on=False),
    "other target": lambda s: s.send_message(msg.GoToPose, name="home"),
    "jaws": lambda s: s.send_message(msg.Gamepad, axes=[0.0] * 4, grip=1.0),
    "program": lambda s: (
        s.send_message(program_messages.AddStep, what="wait", wait_s=0.2),
        s.send_message(program_messages.RunProgram, action="play")),
    "hidden page": lambda s: s.send_message(msg.Heartbeat, visible=False),
    "silent page": lambda s: s.clock.sleep_until(s.clock.now_s() + 3.0),
    "other camera": lambda s: s.send_message(msg.ChooseCamera, camera="sim"),
    "moved camera": lambda s: setattr(s.cameras.video, "before", object()),
    "scene": lambda s: s.arm.scene.add("box", "a wall", center_m=(-0.3, 0, 0.1), size_m=(0.1,) * 3),
}  # fmt: skip


NEEDS_READING = ("torque lost",)  # the arm's thread has to read the servos first


@pytest.mark.parametrize("name", WITHDRAWALS)
def test_stop_fault_or_command_discards_planned_pick(session, name):
    number = session.offered(CUBE)
    WITHDRAWALS[name](session)
    if name in NEEDS_READING:
        session.arm_thread.step()
    session.shown |= session.latest_frames()
    assert session.offer is None
    assert session.panel is None
    before = session.ticks()
    with pytest.raises(BadMessageError):
        session.send_message(msg.ArmAction, action="execute", path=number)
    assert not isinstance(session.arm_thread.job, ExecutePath)
    assert session.ticks() == before


@pytest.mark.full
@pytest.mark.parametrize("name", WITHDRAWALS)
def test_stop_fault_or_command_discards_pick_search(session, slow_search, name):
    session.click(CUBE)
    session.look()
    WITHDRAWALS[name](session)
    if name in NEEDS_READING:
        session.arm_thread.step()
    session.shown |= session.latest_frames()
    assert session.panel is None
    slow_search.set()
    until_s = time.monotonic() + 20.0
    while session.controller._planner._busy is not None and time.monotonic() < until_s:
        time.sleep(0.01)
        session.shown |= session.latest_frames()
    assert session.offer is None
    goal = session.arm_thread.command.goal
    assert goal is None or goal is session.interaction.goal


@pytest.mark.parametrize("message", [
    (msg.SetLive, {"on": True}), (msg.Stop, {}), (msg.Heartbeat, {"visible": True}),
], ids=["live", "stop", "heartbeat"])  # fmt: skip
def test_page_messages_are_answered_during_pick_search(session, slow_search, message):
    session.click(CUBE)
    session.look()
    begun_s = time.perf_counter()
    session.send_message(message[0], **message[1])
    session.controller.frames(session.client)
    session.arm_thread.step() if not session.arm_thread.command.live else None
    assert time.perf_counter() - begun_s < 1.0
    assert not slow_search.is_set()


@pytest.mark.parametrize("view", ["orbit", "top"])
def test_found_block_is_picked_and_placed_by_clicks_in_a_drawing(session, view):
    session.send_message(msg.SetViewport, w=960, h=720, dpr=1, view=view)
    session.click(CUBE)
    session.look()
    assert "No known block is there" in session.text
    session.send_message(msg.Grasp)
    session.until(lambda: session.panel and session.panel["buttons"], "a list")
    drawn = {each["name"]: each["pose"] for each in session.shown["things"]["links"]}
    at = np.array(drawn["the red block"]).reshape(4, 4)[:3, 3]
    assert np.linalg.norm(at - CUBE) < 0.01
    assert session.shown["things"]["things"] == []  # a block is no obstacle
    session.click((0.1, -0.2, 0.0))
    session.look()
    assert "No known block is there" in session.text
    session.go(session.offered(CUBE))
    assert cube_m(session)[2] > 0.06
    assert session.shown["things"]["links"] == []
    session.go(session.offered(GOAL))
    assert np.linalg.norm(cube_m(session)[:2] - GOAL[:2]) < 0.02


def test_pick_needs_a_calibrated_camera(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    with ViewSession() as session:
        refused(session, "needs a calibrated camera", kind=msg.Grasp)


def test_button_of_found_block_plans_its_pick(session):
    session.cameras.video.newest = two_blocks(session)
    session.send_message(msg.Grasp)
    session.until(lambda: session.panel and session.panel["buttons"], "a list")
    buttons = session.panel["buttons"]
    assert session.text == f"Blocks found: {len(buttons)}."
    assert session.offer is None
    first = next(text for text in buttons if "red" in text)
    assert len(first) <= 64
    session.send_message(msg.RunPanelMotion, heading=HEADING, button=first)
    session.until(lambda: session.offer, "an offer")
    assert session.text == f"Pick up {first}."
    refused(session, "out of date", kind=msg.RunPanelMotion, heading=HEADING, button="the moon")
    session.send_message(msg.Acknowledge)
    session.look()
    assert session.panel is None
    refused(session, "out of date", kind=msg.RunPanelMotion, heading=HEADING, button=first)


def two_blocks(session):
    """Return the picture of the session with the cube a second time, in blue."""
    picture = session.cameras.video.newest.copy()
    (u, v), _ = session.camera().model.project(np.array(CUBE))
    part = np.s_[int(v) - 40 : int(v) + 40, int(u) - 40 : int(u) + 40]
    away = np.s_[int(v) + 60 : int(v) + 140, int(u) - 40 : int(u) + 40]
    picture[away] = picture[part][..., ::-1]
    return picture


def test_watcher_and_page_without_control_cannot_pick(session):
    at = session.pixel(CUBE)
    watcher = session.connect(Permission.WATCH)
    other = session.connect(Permission.CONTROL)
    refused(session, "can only watch", kind=msg.Grasp, client=watcher, at=at)
    refused(session, "Another page is in control", kind=msg.Grasp, client=other, at=at)
    number = session.offered(CUBE)
    for client in (watcher, other):
        with pytest.raises(BadMessageError):
            session.send_message(msg.ArmAction, client, action="execute", path=number)
    assert session.arm_thread.job is None
    assert session.offer == number


def test_pick_click_outside_picture_is_refused(session):
    for at in ((-16384.0, 0.0), (16384.0, 16384.0), (5000.0, 300.0)):
        refused(session, "not in the picture|picture", kind=msg.Grasp, at=at)
    session.send_message(msg.Grasp, at=(5.0, 5.0))
    session.until(lambda: session.interaction.refusal, "a refusal")
    assert "shows no coloured block" in session.interaction.refusal.reason
    assert session.offer is None


@pytest.mark.parametrize("at", ["[NaN, 1]", "[1e9, 1]", "[1]", "[1, 2, 3]", '["a", 1]', "{}", "1"])
def test_grasp_message_with_invalid_pixel_is_refused(at):
    text = f'{{"kind": "grasp", "seq": 1, "seen": 0, "at": {at}}}'
    with pytest.raises(BadMessageError, match="cannot be used"):
        msg.read_message(text)


def test_pick_is_refused_in_live_mode_and_beside_known_blocks(session):
    session.enable_live()
    refused(session, "Live", kind=msg.Grasp, at=session.pixel(CUBE))
    session.send_message(msg.SetLive, on=False)
    session.send_message(msg.SetViewport, w=960, h=720, dpr=1, view="side")
    session.send_message(msg.Grasp, at=(1.0, 2.0))
    session.look()
    assert "No known block is there" in session.text
    assert session.offer is None


def test_pick_is_planned_again_after_arm_has_moved(session):
    number = session.offered(CUBE)
    here = session.arm.where().positions
    session.arm.move_joints({"shoulder_pan": here["shoulder_pan"] + 0.2})
    session.arm_thread.step()
    with pytest.raises(BadMessageError, match="moved since"):
        session.send_message(msg.ArmAction, action="execute", path=number)
    session.until(lambda: session.offer not in (None, number), "another offer")
    session.go(session.offer)
    assert cube_m(session)[2] > 0.06


def test_opened_jaws_no_longer_count_as_holding(session):
    session.go(session.offered(CUBE))
    assert session.holds
    session.arm.move_joints({"gripper": session.arm.model.gripper.open})
    session.look()
    assert not session.holds
