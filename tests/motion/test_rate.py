"""Control cycles keep their period, whatever happens between them."""

import itertools

import pytest

from ikservo.motion import Rate


class HandClock:
    """A clock that a test sets; waiting takes no time."""

    def __init__(self):
        self.time_s = 100.0

    def now_s(self):
        return self.time_s

    def sleep_until(self, deadline_s):
        self.time_s = max(self.time_s, deadline_s)


def test_rate_timer_cycles_are_multiples_of_period():
    times_s = list(itertools.islice(Rate(HandClock(), 0.01), 4))
    assert times_s == pytest.approx([0.0, 0.01, 0.02, 0.03])


def test_late_cycle_does_not_delay_next_cycle():
    clock = HandClock()
    times_s = []
    for elapsed_s in itertools.islice(Rate(clock, 0.01), 4):
        times_s.append(elapsed_s)
        clock.time_s += 0.007
    assert times_s == pytest.approx([0.0, 0.01, 0.02, 0.03])


def test_missed_timer_cycles_are_skipped():
    clock = HandClock()
    metronome = Rate(clock, 0.01)
    times_s = []
    for elapsed_s in itertools.islice(metronome, 3):
        times_s.append(elapsed_s)
        clock.time_s += 0.035 if len(times_s) == 1 else 0.0
    assert times_s == pytest.approx([0.0, 0.035, 0.04])
    assert metronome.cycles == 3
