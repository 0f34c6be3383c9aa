"""A servo is tracked while a hand moves it, and lost if its turns cannot be counted."""

import pytest

from ikservo.apps.calibrating.range_tracker import RangeTracker

TURN = 4096


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize(("ticks", "lost"), [(1024, False), (1025, True)])
def test_turn_tracker_follows_quarter_turn_between_readings(way, ticks, lost):
    assert RangeTracker.start_at(TURN, 2000, 0.0).update(2000 + way * ticks, 0.02).lost is lost


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize(("gap_s", "lost"), [(0.58, False), (0.59, True)])
def test_turn_tracker_is_lost_if_gap_allows_unseen_half_turn(way, gap_s, lost):
    # 4096 - 256 ticks the other way round take 0.586 s at 1.6 turns/s
    assert RangeTracker.start_at(TURN, 2000, 5.0).update(2000 + way * 256, 5.0 + gap_s).lost is lost


def test_turn_tracker_continues_across_encoder_wrap_around():
    track = RangeTracker.start_at(TURN, 4000, 0.0).update(100, 0.02)
    assert (track.tick, track.low, track.high, track.lost) == (4196, 4000, 4196, False)


@pytest.mark.parametrize("gap_s", [0.02, 60.0])
def test_potentiometer_tracker_never_loses_turn_count(gap_s):
    track = RangeTracker.start_at(0, 10, 0.0).update(1020, gap_s)
    assert (track.lost, track.low, track.high, track.width) == (False, 10, 1020, 1010)


def test_lost_turn_tracker_stays_lost_until_restarted():
    track = RangeTracker.start_at(TURN, 0, 0.0).update(2000, 0.02).update(2010, 0.04)
    assert track.lost
    again = track.restarted()
    assert (again.lost, again.low, again.high, again.tick) == (False, 2010, 2010, 2010)


def test_turn_tracker_accepts_any_step_of_multi_turn_count():
    track = (
        RangeTracker.start_at(TURN, 100, 0.0)
        .update_unwrapped(9000, 1.0)
        .update_unwrapped(-9000, 2.0)
    )
    assert (track.low, track.high, track.tick) == (-9000, 9000, -9000)
    assert (track.at_s, track.lost) == (2.0, False)


@pytest.mark.parametrize(("now", "earlier"), [(False, True), (True, False)])
def test_combined_swept_range_is_lost_if_either_part_is_lost(now, earlier):
    one = RangeTracker(TURN, 5, 0, 9, 1.0, lost=now)
    both = one.with_range_of(RangeTracker(TURN, 50, 40, 60, 0.0, lost=earlier))
    assert (both.tick, both.low, both.high, both.lost) == (5, 40, 60, True)
    assert not RangeTracker(TURN, 5, 0, 9, 1.0).with_range_of(RangeTracker(TURN, 5, 0, 9, 0.0)).lost
