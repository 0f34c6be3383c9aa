"""Turns of errors are counted while one follows the other in time."""

import math

import numpy as np

from ikservo.control.turn_counter import TurnCounter

CYCLE_S = 0.005


def counted(frequency_hz, half_width, seconds=2.0, fresh=True):
    counter = TurnCounter(np.array([0.01]), within_s=0.4)
    for k in range(round(seconds / CYCLE_S)):
        error = half_width * math.sin(2.0 * math.pi * frequency_hz * k * CYCLE_S)
        counter.update(np.array([error]), CYCLE_S, fresh=np.array([fresh]))
    return counter


def test_a_swing_turns_round_twice_a_period_by_its_whole_width():
    counter = counted(4.0, 0.02)
    assert 15 <= counter.count[0] <= 17
    assert np.isclose(counter.width[0], 0.04, rtol=0.02)


def test_small_turns_are_noise():
    assert counted(4.0, 0.004).count[0] == 0


def test_slow_turns_do_not_follow_one_another():
    assert counted(0.5, 0.02, seconds=8.0).count[0] == 1


def test_joints_that_were_not_read_have_not_turned():
    assert counted(4.0, 0.02, fresh=False).count[0] == 0


def test_a_motion_begins_without_turns():
    counter = counted(4.0, 0.02)
    counter.begin()
    assert counter.count[0] == 0
