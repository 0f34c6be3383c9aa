"""When a page falls silent, a planned motion survives a short gap; following the page ends."""

from itertools import pairwise

import numpy as np
import pytest

from ikservo.apps.page.messages import page_messages
from ikservo.arm import open_arm
from tests.apps.page.view_session import ViewSession
from tests.arm.simulated import true_joints

GOAL_DEG = 80.0
FAR_S = 0.5  # into a motion that takes several seconds at the slow speed
BRAKING_S = 0.3


@pytest.fixture
def session():
    with ViewSession(open_arm("so101", "sim:?pose=home")) as session:
        yield session


def go_there(session, silent_s, on_cycle=lambda _: None):
    """Let the arm go to the preview during a silence of the page; return the time of each goal.

    Heartbeats end ``FAR_S`` after the first control cycle and come again after the silence.
    """
    session.send_message(page_messages.SetJoint, joint="shoulder_pan", value=GOAL_DEG)
    session.go_there()
    sent_goals, original, begun_s = session.record_goals(), session.arm_thread.on_progress, []

    def seen(progress):
        original(progress)
        begun_s.append(session.clock.now_s())
        elapsed_s = begun_s[-1] - begun_s[0]
        if not FAR_S < elapsed_s < FAR_S + silent_s:
            session.send_message(page_messages.Heartbeat, visible=True)
        on_cycle(elapsed_s)

    session.arm_thread.on_progress = seen
    session.arm_thread.step()
    session.arm_thread.step()
    changed = [
        time_s
        for (_, before), (time_s, goal) in pairwise(sent_goals)
        if not np.array_equal(goal, before)
    ]
    return np.array(changed) - begun_s[0]


def pan_deg(session):
    return np.degrees(true_joints(session.arm)["shoulder_pan"])


def test_planned_motion_continues_for_2_s_without_page(session):
    go_there(session, 2.0)
    assert session.arm_thread.snapshot.stop_notice is None
    assert pan_deg(session) == pytest.approx(GOAL_DEG, abs=2.0)


def test_planned_motion_ends_when_page_stays_silent(session):
    moved_s = go_there(session, 60.0)
    assert 2.0 + FAR_S < moved_s[-1] < 2.5 + FAR_S + BRAKING_S
    assert "does not answer" in session.arm_thread.snapshot.stop_notice.message
    assert pan_deg(session) < GOAL_DEG - 5.0


@pytest.mark.full
@pytest.mark.parametrize("way", ["closed", "hidden"])
def test_planned_motion_ends_at_once_when_page_is_gone(session, way):
    gone = []

    def leave(elapsed_s):
        if elapsed_s > 2 * FAR_S and not gone:
            gone.append(elapsed_s)
            if way == "closed":
                session.controller.disconnect(session.client)
            else:
                session.send_message(page_messages.Heartbeat, visible=False)

    moved_s = go_there(session, 60.0, leave)
    assert moved_s[-1] < gone[0] + BRAKING_S
    assert session.arm_thread.snapshot.stop_notice is not None
