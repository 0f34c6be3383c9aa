"""Reasons that keep a sweep from ending, and their messages, at the bounds."""

import math
from dataclasses import replace

import pytest

from ikservo.apps.calibrating.by_hand_procedure import (
    blocking_issues,
    is_full_turn,
    range_complete,
    warnings,
)
from tests.apps.calibrating.test_sweep import TURN, Hand, subject


def swept(one, up, down=0, **more):
    """Return a state whose only joint was moved by the given ticks, one tick at a time."""
    hand = Hand(one, **more).rest().accept().move(up, step=1)
    return (hand.move(-down, step=1) if down else hand).state


def messages_of(state):
    return [issue.message for issue in blocking_issues(state)]


@pytest.mark.parametrize(("ticks", "round_"), [(4073, False), (4074, True)])
def test_sweep_within_2_degrees_of_full_turn_counts_as_full_turn(ticks, round_):
    one = subject(lower=-3.1, upper=3.1)
    assert is_full_turn(swept(one, ticks), one) is round_


def test_sweep_of_358_of_360_ticks_counts_as_full_turn():
    one = replace(subject(), ticks_per_turn=360)
    state = Hand(one, start=0).rest().accept().state
    for width, round_ in ((357, False), (358, True)):
        tracks = {1: replace(state.tracks[1], low=0, high=width)}
        assert is_full_turn(replace(state, tracks=tracks), one) is round_


def test_potentiometer_joint_never_counts_as_full_turn():
    one = replace(subject(), ticks_per_turn=0)
    assert not is_full_turn(swept(one, 100), one)


@pytest.mark.parametrize(("width_deg", "reported"), [(299.5, True), (300.5, False)])
def test_full_turn_of_joint_with_range_below_300_deg_is_reported(width_deg, reported):
    half = math.radians(width_deg) / 2
    messages = messages_of(swept(subject(lower=-half, upper=half), 4100))
    assert any("was moved by a full turn" in each for each in messages) is reported


def test_continuous_joint_counts_as_completely_swept():
    hand = Hand(subject()).rest().accept()
    assert range_complete(hand.state, hand.state.subjects[0]) is False
    hand.say("continuous elbow")
    assert range_complete(hand.state, hand.state.subjects[0]) is True


@pytest.mark.parametrize(("ticks", "reported"), [(249, True), (250, False)])
def test_swept_joint_must_move_50_ticks_plus_both_margins(ticks, reported):
    margin_rad = 100 * math.tau / TURN
    messages = messages_of(swept(subject(), ticks, margin_rad=margin_rad))
    assert any(f"was moved by only {ticks} ticks" in each for each in messages) is reported


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize(("apart", "reported"), [(40, False), (41, True)])
def test_two_servos_of_one_joint_may_differ_by_40_ticks(way, apart, reported):
    hand = Hand(subject(shadow_ids=(2,)), start=700).rest().accept()
    hand.move(900, 1, 2).move(way * apart, 2, step=1)
    messages = messages_of(hand.state)
    assert any("report different motions" in each for each in messages) is reported


def test_partial_sweep_is_reported_with_its_percentage():
    half = swept(subject(), 489, 978)
    assert [*warnings(half)] == ["elbow was swept over 50% of the arm file's range."]
    assert [*warnings(swept(subject(), 900, 1900))] == []


def swept_deg(lower_deg, upper_deg, low_deg, high_deg):
    """Return a state whose only joint has this range in its arm file and was swept over it."""
    one = subject(lower=math.radians(lower_deg), upper=math.radians(upper_deg))
    state = Hand(one, start=0).rest().accept().state
    low, high = (round(end_deg / 360 * TURN) for end_deg in (low_deg, high_deg))
    return replace(state, tracks={1: replace(state.tracks[1], low=low, high=high)})


def is_reported_mirrored(state):
    return any("the sign or the pose is wrong" in each for each in messages_of(state))


@pytest.mark.parametrize(("apart_deg", "reported"), [(14.5, False), (15.5, True)])
def test_mirrored_range_with_ends_off_by_30_deg_is_reported(apart_deg, reported):
    near_deg, far_deg = 60.0, 60.0 + apart_deg
    assert is_reported_mirrored(swept_deg(-near_deg, far_deg, -far_deg, near_deg)) is reported


@pytest.mark.parametrize(("short_deg", "reported"), [(29.0, True), (31.0, False)])
def test_swept_range_that_fits_better_mirrored_is_reported(short_deg, reported):
    # off by 120 less what is missing of the sweep; mirrored only by what is missing
    assert is_reported_mirrored(swept_deg(-40, 100, short_deg - 100, 40)) is reported


def test_swept_range_outside_arm_file_range_is_reported():
    lopsided = subject(pose=-1.4, lower=-1.5, upper=1.5)
    hand = Hand(lopsided).rest().accept()
    hand.move(-400).move(400).move(-400).move(400).move(1900)  # both times the wrong way
    (messages,) = [
        each for each in messages_of(hand.state) if "the sign or the pose is wrong" in each
    ]
    assert messages.startswith(
        "elbow was swept from -247.2° to -45.1°, but the arm file says -85.9° to 85.9°;"
    )
