"""The page shows the servos' true torque state in motion, at a stop and when limp."""

import pytest

from ikservo.apps.page.messages import page_messages
from ikservo.arm import StopKind, StopReason, open_arm
from ikservo.arm.control_server import command_handler
from ikservo.arm.service import ArmService
from ikservo.serving.control_client import ControlCommand, Request
from tests.apps.page.view_session import ViewSession
from tests.arm.simulated import line_of, servo_id


@pytest.fixture
def session():
    with ViewSession(open_arm("so101", "sim:?pose=home")) as session:
        yield session


@pytest.fixture
def limp(session):
    session.arm.disable_torque()
    session.arm_thread.step()
    return session


def torque(session):
    """Return the torque state of each servo that the page shows."""
    return [row["torque"] for row in session.latest_frames()["status"]["health"]["joints"]]


def go_there(session, on_progress):
    """Let the arm go to the preview; call a function in each control cycle of the motion."""
    session.send_message(page_messages.SetJoint, joint="wrist_roll", value=40.0)
    session.go_there()
    original = session.arm_thread.on_progress

    def seen(progress):
        original(progress)
        session.send_message(page_messages.Heartbeat, visible=True)
        on_progress()

    session.arm_thread.on_progress = seen
    session.arm_thread.step()
    session.arm_thread.on_progress = original


@pytest.mark.full
def test_moving_limp_arm_shows_torque_on_from_first_cycle(limp):
    said = []
    go_there(limp, lambda: said or said.append(torque(limp)))
    assert set(said[0]) == {"on"}


def test_stop_during_first_motion_reports_that_torque_stays_on(limp):
    go_there(limp, lambda: limp.send_message(page_messages.Stop, by="Escape"))
    notice = limp.arm_thread.snapshot.stop_notice
    assert notice.message == "Stopped by the Escape key on the page; torque stays on."


def test_stop_of_limp_resting_arm_does_not_need_acknowledgement(limp):
    limp.send_message(page_messages.Stop, by="Escape")
    limp.arm_thread.step()
    status = limp.latest_frames()["status"]
    assert (status["mode"], status["banner"], status["stop_count"]) == ("preview", None, 1)
    said = status["messages"][-1]
    assert said["message"].endswith("torque is off; the arm is limp.")
    assert said["level"] == ""
    assert limp.arm.stop_reason is None


def test_stop_of_limp_arm_drops_queued_commands(limp):
    limp.send_message(page_messages.SetTorque, joint="wrist_roll", on=True)
    limp.send_message(page_messages.Stop)
    limp.arm_thread.step()
    limp.arm_thread.step()
    assert set(torque(limp)) == {"off"}


def test_stop_is_latched_even_if_arm_cannot_be_read(limp):
    line_of(limp.arm).plugged = False
    limp.send_message(page_messages.Stop)
    limp.arm_thread.step()
    assert limp.arm_thread.snapshot.stop_notice is not None


def test_stop_by_another_program_is_latched_on_limp_arm(limp):
    limp.arm.request_stop(StopReason(StopKind.PROGRAM, "Stopped by a program."))
    limp.arm_thread.step()
    assert limp.arm_thread.snapshot.stop_notice is not None


def test_stop_notice_names_servo_that_lost_torque(session):
    line = line_of(session.arm)
    line.servos[servo_id("so101", "wrist_flex")].write("torque_enable", 0)
    session.send_message(page_messages.Stop, by="button")
    session.arm_thread.step()
    assert "the torque of wrist_flex is off" in session.arm_thread.snapshot.stop_notice.message


@pytest.mark.full
def test_hand_guided_arm_is_shown_as_limp(session):
    go_there(session, lambda: None)
    session.arm.disable_torque()
    session.arm_thread.step()
    for _ in range(3):
        session.clock.sleep_until(session.clock.now_s() + 0.2)
        session.arm_thread.on_guided(session.arm_thread.snapshot.measured)
    assert set(torque(session)) == {"off"}


@pytest.mark.parametrize(("on", "says"), [(True, "Stopped from another terminal; torque stays on."),
                                          (False, "torque is off; the arm is limp.")])  # fmt: skip
def test_stop_from_other_terminal_is_shown_on_resting_arm(session, on, says):
    if not on:
        session.arm.disable_torque()
    session.arm_thread.step()
    command_handler(ArmService(session.arm))(Request(ControlCommand.STOP))
    session.arm_thread.step()
    status = session.latest_frames()["status"]
    assert status["mode"] == "stopped"
    assert status["banner"]["message"].endswith(says)
    session.send_message(page_messages.Acknowledge)
    session.arm_thread.step()
    session.arm_thread.step()
    assert session.latest_frames()["status"]["mode"] == "preview"
