"""Reversals of an error are counted only if they follow each other closely in time."""

import math

import numpy as np

from ikservo.control.reversal_counter import ReversalCounter

CYCLE_S = 0.005


def counted(frequency_hz, half_width, seconds=2.0, fresh=True):
    counter = ReversalCounter(np.array([0.01]), within_s=0.4)
    for k in range(round(seconds / CYCLE_S)):
        error = half_width * math.sin(2.0 * math.pi * frequency_hz * k * CYCLE_S)
        counter.update(np.array([error]), CYCLE_S, fresh=np.array([fresh]))
    return counter


def test_reversal_counter_counts_two_per_swing_period():
    counter = counted(4.0, 0.02)
    assert 15 <= counter.count[0] <= 17
    assert np.isclose(counter.width[0], 0.04, rtol=0.02)


def test_reversal_counter_ignores_small_reversals():
    assert counted(4.0, 0.004).count[0] == 0


def test_reversal_counter_ignores_slow_reversals():
    assert counted(0.5, 0.02, seconds=8.0).count[0] == 1


def test_reversal_counter_ignores_joints_that_were_not_read():
    assert counted(4.0, 0.02, fresh=False).count[0] == 0


def test_reversal_counter_is_reset_when_a_motion_begins():
    counter = counted(4.0, 0.02)
    counter.begin()
    assert counter.count[0] == 0
