"""Virtual time at real speed, compared with a machine clock that a test sets."""

import pytest

from servosim.clock import PacedClock


class Machine:
    def __init__(self):
        self.time_s = 100.0
        self.slept_s = 0.0

    def now_s(self):
        return self.time_s

    def sleep_until(self, deadline_s):
        self.slept_s += deadline_s - self.time_s
        self.time_s = deadline_s


@pytest.fixture
def machine():
    return Machine()


def test_paced_clock_waits_for_requested_time(machine):
    clock = PacedClock(machine=machine)
    clock.sleep_until(0.5)
    assert (clock.now_s(), machine.slept_s) == (0.5, 0.5)


def test_paced_clock_accumulates_waits_below_1_ms(machine):
    clock = PacedClock(machine=machine)
    for microseconds in range(100, 1600, 100):
        clock.sleep_until(microseconds * 1e-6)
    assert machine.slept_s == pytest.approx(0.001)


@pytest.mark.parametrize(("stall_s", "now_s"), [(0.015, 0.015), (0.03, 0.03), (2.0, 0.03)])
def test_paced_clock_catches_up_at_most_20_ms(machine, stall_s, now_s):
    clock = PacedClock(machine=machine)
    machine.time_s += stall_s
    clock.sleep_until(0.01)
    assert clock.now_s() == pytest.approx(now_s)
    assert machine.slept_s == 0.0
    clock.sleep_until(1.0)
    assert machine.slept_s == pytest.approx(1.0 - now_s)


def test_paced_clock_advances_simulated_time(machine):
    reported = []
    PacedClock(reported.append, machine).sleep_until(0.25)
    assert reported == [0.25]
