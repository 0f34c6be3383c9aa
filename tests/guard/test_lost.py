"""One lost reply is tolerated; the third in a row stops the arm."""

import pytest

from ikservo.errors import ServoSilentError
from ikservo.guard import CommunicationMonitor

BOTH, ONE = {"elbow", "wrist"}, {"wrist"}


def test_third_cycle_without_reply_raises_error_naming_joint():
    losses = CommunicationMonitor(["elbow", "wrist"])
    losses.update(ONE)
    losses.update(ONE)
    with pytest.raises(ServoSilentError, match="elbow did not answer 3 times in a row"):
        losses.update(ONE)


def test_lost_servo_error_names_all_silent_joints():
    losses = CommunicationMonitor(["elbow", "wrist"], max_lost=1)
    with pytest.raises(ServoSilentError, match="elbow, wrist did not answer"):
        losses.update(())


def test_reply_restarts_count_of_missed_replies():
    losses = CommunicationMonitor(["elbow", "wrist"])
    for answered in (ONE, ONE, BOTH, ONE, ONE):
        losses.update(answered)
    assert losses.lost_joints == ("elbow",)


def test_missed_replies_are_counted_per_joint():
    losses = CommunicationMonitor(["elbow", "wrist"])
    for answered in ({"elbow"}, {"wrist"}, {"elbow"}, {"wrist"}):
        losses.update(answered)


def test_no_joint_is_reported_lost_if_all_joints_reply():
    losses = CommunicationMonitor(["elbow", "wrist"])
    losses.update(ONE)
    losses.update(BOTH)
    assert losses.lost_joints == ()
