"""A shifted zero is detected by ends beyond those of the arm file, in rad and m."""

import math
from dataclasses import replace

import pytest

from ikservo.apps.calibrating.by_hand_dialogue import check_zeros
from ikservo.apps.calibrating.calibration_result import find_shifted_zeros
from ikservo.calibration import JointMap, Limits
from ikservo.maintenance.dialogue import Notice, Question
from tests.apps.calibrating.test_sweep import TURN, Hand, subject

TICKS_PER_M = TURN / 0.1
SLIDE = replace(
    subject(),
    joint_map=JointMap.prismatic("elbow", 1, 1, 0, TURN, 0.1),
    expected=Limits.of("elbow", -0.02, 0.02, "arm file", "m"),
)


def shifts_of(one, *ticks):
    """Return the reported shifts [rad or m] after a joint was swept to these ticks."""
    hand = Hand(one, start=0).rest().accept()
    tracks = {1: replace(hand.state.tracks[1], low=min(ticks), high=max(ticks))}
    state = replace(hand.state, tracks=tracks)
    return [found.shift for found in find_shifted_zeros(state, may_have_sagged=True)]


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize(("shift_m", "reported"), [(0.0039, False), (0.0041, True)])
def test_zero_shift_of_sliding_joint_is_reported_above_4_mm(way, shift_m, reported):
    ends = [round((way * shift_m + end) * TICKS_PER_M) for end in (-0.0205, 0.0205)]
    found = shifts_of(SLIDE, *ends)
    assert found == ([pytest.approx(-way * shift_m, abs=1e-4)] if reported else [])


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize(("shift_m", "reported"), [(0.0019, False), (0.0021, True)])
def test_range_shift_of_sliding_joint_is_reported_above_2_mm(way, shift_m, reported):
    ends = [round((way * shift_m + end) * TICKS_PER_M) for end in (-0.02, 0.02)]
    assert len(shifts_of(SLIDE, *ends)) == reported


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize(("shift_deg", "reported"), [(4.8, False), (5.2, True), (7.1, True)])
def test_joint_range_shift_is_reported_above_5_degrees(way, shift_deg, reported):
    ends = [round(way * shift_deg / 360 * TURN + end / math.tau * TURN) for end in (-1.5, 1.5)]
    found = [math.degrees(shift) for shift in shifts_of(subject(), *ends)]
    assert found == ([pytest.approx(-way * shift_deg, abs=0.1)] if reported else [])


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize(("shift_deg", "reported"), [(9.9, False), (10.1, True)])
def test_joint_zero_shift_is_reported_above_10_degrees(way, shift_deg, reported):
    ends = [round(way * shift_deg / 360 * TURN + end / math.tau * TURN) for end in (-1.53, 1.53)]
    found = [math.degrees(shift) for shift in shifts_of(subject(), *ends)]
    assert found == ([pytest.approx(-way * shift_deg, abs=0.1)] if reported else [])


@pytest.mark.parametrize("way", [1, -1])
def test_zero_shift_is_reported_without_sign(way):
    hand = Hand(subject(), start=0).rest().accept()
    shifted = [round(way * 20 / 360 * TURN + end / math.tau * TURN) for end in (-1.5, 1.5)]
    tracks = {1: replace(hand.state.tracks[1], low=shifted[0], high=shifted[1])}
    (found,) = find_shifted_zeros(replace(hand.state, tracks=tracks))
    assert str(found).endswith("the zero seems to be off by 20.0°.")


def test_zero_of_unswept_joint_is_not_checked():
    hand = Hand(subject("a", 1), subject("b", 2)).rest().accept().say("skip a").move(1500, 2)
    assert [found.subject.name for found in find_shifted_zeros(hand.state)] == ["b"]


def test_small_zero_shift_after_auto_sweep_needs_confirmation():
    hand = Hand(subject(), start=0).rest().accept()
    ends = [round(7.0 / 360 * TURN + end / math.tau * TURN) for end in (-1.5, 1.5)]
    tracks = {1: replace(hand.state.tracks[1], low=ends[0], high=ends[1])}
    state = replace(hand.state, tracks=tracks)
    (notice,) = check_zeros(state, "rest", "so101")
    assert isinstance(notice, Notice)
    assert "the zero seems to be off by 7.0°" in notice.text
    after_drive = [*check_zeros_answers(state)]
    assert isinstance(after_drive[-1], Question)


def check_zeros_answers(state):
    """Yield the messages and questions after a drive to the ends, up to the first question."""
    for item in check_zeros(state, "rest", "so101", may_have_sagged=True):
        yield item
        if isinstance(item, Question):
            return
