"""The meter of each joint while it is moved."""

import math

import pytest

from ikservo.apps.calibrating.by_hand_procedure import joint_readouts
from ikservo.calibration.homing import TickRange
from ikservo.maintenance.dialogue import JointProgress
from tests.apps.calibrating.test_sweep import TURN, Hand, subject


def shown(hand):
    """Return the meter of a hand with one joint."""
    (meter,) = joint_readouts(hand.state)
    return meter


@pytest.mark.parametrize(
    ("ticks", "state"), [(49, JointProgress.UNMOVED), (50, JointProgress.MOVING)]
)
def test_joint_counts_as_moved_after_50_ticks(ticks, state):
    assert shown(Hand(subject()).rest().accept().move(ticks, step=1)).state is state


@pytest.mark.parametrize(
    ("ticks", "state"),
    [
        (1564, JointProgress.MOVING),
        (1565, JointProgress.COMPLETE),
        (4050, JointProgress.COMPLETE),
        (4074, JointProgress.FREE),
    ],
)
def test_sweep_is_complete_at_80_percent_and_free_at_full_turn(ticks, state):
    # 3 rad are 1955.7 ticks; a turn less two degrees is 4073.2
    assert shown(Hand(subject()).rest().accept().move(ticks, step=1)).state is state


def test_sweep_meter_shows_that_joint_range_is_known():
    assert (
        shown(Hand(subject(known=TickRange(0, 2000))).rest().accept()).state is JointProgress.KNOWN
    )


def test_sweep_meter_shows_continuous_joint_as_free():
    hand = Hand(subject()).rest().accept().say("continuous elbow")
    assert shown(hand).state is JointProgress.FREE


def test_sweep_meter_shows_position_and_swept_range():
    hand = Hand(subject(pose=0.5)).rest().accept().move(1000).move(-1500)
    meter = shown(hand)
    rad = math.tau / TURN
    assert (meter.low, meter.high) == pytest.approx((0.5 - 500 * rad, 0.5 + 1000 * rad))
    assert meter.position == pytest.approx(0.5 - 500 * rad)
    assert meter.name == "elbow"
