"""A hand moves the goal of the page, and the arm in Live; silence and refusals hold it."""

import json
import math

import numpy as np
import pytest

from ikservo.apps.page.messages import page_messages
from ikservo.apps.page.messages.page_messages import BadMessageError, read_message
from ikservo.apps.page.server.message_age_and_rate import MessageFilter, StaleMessageError
from tests.apps.page.view_session import ViewSession
from tests.arm.simulated import true_tip_m

STILL = (1.0, 0.0, 0.0, 0.0)
EVERY = 3  # control cycles between two poses: about 70 Hz


@pytest.fixture
def session():
    with ViewSession() as opened:
        yield opened


def send(session, shift_m=(0.0, 0.0, 0.0), *, held=True, **fields):
    position = tuple(1.0 + x for x in shift_m)
    fields = {"rotation": STILL, "clutch": 1, **fields}
    session.send_message(page_messages.TrackHand, position=position, held=held, **fields)


def goal_tip_m(session):
    return session.arm.chain.forward(session.interaction.shown_goal)[:3, 3]


def test_tracked_hand_moves_preview_but_no_servo(session):
    before, ticks = true_tip_m(session.arm), session.ticks()
    for k in range(60):
        session.clock.sleep_until(session.clock.now_s() + 0.016)
        send(session, (0.0, 0.03 * min(1.0, k / 30), 0.0))
    np.testing.assert_allclose(goal_tip_m(session) - before, (0.0, 0.03, 0.0), atol=3e-3)
    assert session.ticks() == ticks


def test_closing_clutch_at_another_hand_pose_moves_nothing(session):
    send(session)
    before = session.interaction.goal
    for k in range(20):
        session.clock.sleep_until(session.clock.now_s() + 0.016)
        send(session, (0.4 * math.sin(k), 0.3, -0.2), held=False)
    send(session, (0.2, 0.3, -0.2), clutch=2)
    np.testing.assert_allclose(session.interaction.goal, before, atol=1e-6)


def test_arm_follows_tracked_hand_and_holds_when_it_is_lost(session):
    session.enable_live()
    before, tips = true_tip_m(session.arm), []

    def move(number):
        tips.append(true_tip_m(session.arm))
        if number % EVERY == 0 and number < 300:
            send(session, (0.0, 0.06 * min(1.0, number / 200), 0.0))
        elif number == 300:
            send(session, held=False)
        elif number > 300 and number % EVERY == 0:
            send(session, (0.5, 0.5, 0.5), held=False)

    session.run(500, move)
    np.testing.assert_allclose(tips[300] - before, (0.0, 0.06, 0.0), atol=6e-3)
    assert np.abs(np.array(tips[400:]) - tips[380]).max() < 2e-3


def test_tip_of_hand_guided_arm_slides_along_table(session):
    session.enable_live()
    seen = []

    def move(number):
        seen.append((*true_tip_m(session.arm), session.interaction.refusal is not None))
        down_m = np.interp(number, (0, 300, 700, 1000), (0.0, 0.3, 0.3, 0.0))
        aside_m = np.interp(number, (400, 650, 700, 1000), (0.0, 0.05, 0.05, 0.0))
        if number % EVERY == 0:
            send(session, (0.03, float(aside_m), -float(down_m)))
        session.controller.frames(session.client)

    session.run(1150, move)
    tips_m, refused = np.array(seen)[:, :3], np.array(seen)[:, 3]
    assert tips_m[:, 2].min() > -0.005
    assert refused[:700].any()
    assert tips_m[690, 1] - tips_m[0, 1] == pytest.approx(0.05, abs=0.01)
    assert tips_m[690, 2] < 0.05
    np.testing.assert_allclose(tips_m[-1], tips_m[0], atol=0.015)
    assert np.abs(np.diff(np.array(session.goals), axis=0)).max() < math.radians(2.0)


def test_page_shows_what_limits_motion_of_tracked_hand(session):
    session.arm_thread.step()
    for k in range(60):
        session.clock.sleep_until(session.clock.now_s() + 0.016)
        send(session, (0.02 * k, 0.0, 0.0), stamp=100.0 + k)
    session.clock.sleep_until(session.clock.now_s() + 0.05)
    session.arm_thread.step()
    frame = session.latest_frames()["hand"]
    assert (frame["stamp"], frame["held"]) == (159.0, True)
    assert frame["limit"]
    assert session.interaction.marker.gap_m > 0.1


def test_stop_opens_clutch_of_tracked_hand(session):
    send(session)
    session.send_message(page_messages.Stop)
    session.arm_thread.step()
    send(session, (0.0, 0.05, 0.0))
    assert session.interaction.goal is None
    assert not session.interaction.hand.is_held


def wait(session, duration_s):
    session.clock.sleep_until(session.clock.now_s() + duration_s)


def moved_by(session, clutch, count=20):
    """Return how far the goal moves with a hand that holds on."""
    before, goal = true_tip_m(session.arm), session.interaction.shown_goal
    start_m = before if goal is None else goal_tip_m(session)
    for k in range(count):
        wait(session, 0.016)
        send(session, (0.0, 0.004 * k, 0.0), clutch=clutch)
    if session.interaction.goal is None:
        return 0.0
    return float(np.linalg.norm(goal_tip_m(session) - start_m))


def pause(session):
    wait(session, 0.35)


def silence(session):
    wait(session, 0.35)
    session.latest_frames()
    assert not session.interaction.hand.is_held
    send(session, held=False)


def stop_and_acknowledge(session):
    session.send_message(page_messages.Stop)
    session.arm_thread.step()
    send(session)
    session.send_message(page_messages.Acknowledge)
    session.arm_thread.step()
    session.arm_thread.step()


def press_while_stopped(session):
    send(session, held=False)
    session.send_message(page_messages.Stop)
    session.arm_thread.step()
    send(session)
    session.send_message(page_messages.Acknowledge)
    session.arm_thread.step()
    session.arm_thread.step()


def undo(session):
    session.send_message(page_messages.Undo)


def go_to_pose(session):
    session.send_message(page_messages.GoToPose, name="rest")


def lose_control(session):
    other = session.connect()
    session.send_message(page_messages.TakeControl, other, on=True)
    for _ in range(3):
        with pytest.raises(BadMessageError):
            send(session)
    session.send_message(page_messages.TakeControl, on=True)


@pytest.mark.parametrize(
    "release", [pause, silence, stop_and_acknowledge, press_while_stopped, undo, go_to_pose]
)
def test_clutch_opened_by_server_must_be_pressed_again(session, release):
    assert moved_by(session, clutch=1) > 0.01
    release(session)
    assert moved_by(session, clutch=1) == pytest.approx(0.0, abs=1e-6)
    wait(session, 0.05)
    session.arm_thread.step()
    frame = session.latest_frames()["hand"]
    assert (frame["held"], frame["limit"]) == (False, "let go first")
    assert moved_by(session, clutch=2) > 0.01


def test_clutch_pressed_without_control_moves_nothing(session):
    lose_control(session)
    assert moved_by(session, clutch=1) == 0.0
    assert moved_by(session, clutch=2) > 0.01


def test_new_clutch_press_without_release_causes_no_jump(session):
    assert moved_by(session, clutch=1) > 0.01
    before = session.interaction.goal
    wait(session, 0.016)
    send(session, (0.0, 0.12, 0.03), clutch=2)
    np.testing.assert_allclose(session.interaction.goal, before, atol=1e-6)


def test_late_clutch_release_message_is_accepted():
    intake = MessageFilter(0.0, read_message)
    intake.record_sent(0.0)
    fields = {"kind": "track_hand", "seen": 0, "position": [0, 0, 0], "rotation": STILL}
    with pytest.raises(StaleMessageError):
        intake.accept(json.dumps({**fields, "seq": 1, "held": True, "clutch": 1}), 5.0)
    late = json.dumps({**fields, "seq": 2, "held": False, "clutch": 1})
    assert not intake.accept(late, 5.0).held


def test_hand_pose_with_invalid_rotation_is_refused(session):
    with pytest.raises(BadMessageError):
        send(session, rotation=(1.0, 1.0, 0.0, 0.0))
