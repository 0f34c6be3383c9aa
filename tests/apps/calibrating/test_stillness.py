"""An arm counts as still after half a second without motion, and no sooner."""

import pytest

from ikservo.control.stillness import StillnessDetector, read_until_at_rest


def after(readings):
    """Return the detector after readings (s, ticks of servo 1, ticks of servo 2)."""
    stillness = StillnessDetector()
    for at_s, one, other in readings:
        stillness = stillness.add_reading(at_s, {1: one, 2: other})
    return stillness


@pytest.mark.parametrize(("until_s", "still"), [(0.25, False), (0.375, False), (0.5, True)])
def test_arm_counts_as_at_rest_after_half_a_second(until_s, still):
    times = [0.125 * k for k in range(1 + int(until_s / 0.125))]
    assert after([(at_s, 7, 9) for at_s in times]).is_at_rest() is still


@pytest.mark.parametrize(("step_s", "still"), [(0.164, False), (0.168, True)])
def test_rest_detection_does_not_depend_on_clock_start(step_s, still):
    assert after([(9.0 + step_s * k, 7, 9) for k in range(4)]).is_at_rest() is still


def test_rest_detection_needs_three_readings():
    assert not after([(0.0, 7, 9), (0.5, 7, 9)]).is_at_rest()
    assert after([(0.0, 7, 9), (0.25, 7, 9), (0.5, 7, 9)]).is_at_rest()


@pytest.mark.parametrize(("most", "still"), [(4, True), (5, False)])
@pytest.mark.parametrize("servo", [1, 2])
def test_servo_vibrating_by_four_ticks_is_at_rest(most, still, servo):
    ticks = [(0, most)[k % 2] for k in range(5)]
    rows = [(0.125 * k, *((t, 0) if servo == 1 else (0, t))) for k, t in enumerate(ticks)]
    assert after(rows).is_at_rest() is still


def test_readings_older_than_half_second_are_dropped():
    moved = after([(0.0, 900, 0), (0.125, 100, 0), *((0.125 * k, 7, 9) for k in range(2, 7))])
    assert moved.is_at_rest()
    assert moved.mean_ticks() == {1: 7.0, 2: 9.0}
    assert moved.readings[0][0] == 0.25


def test_reading_that_begins_half_second_window_is_kept():
    rare = after([(0.0, 7, 9), (0.375, 7, 9), (0.75, 7, 9)])
    assert [at_s for at_s, _ in rare.readings] == [0.0, 0.375, 0.75]
    assert rare.is_at_rest()


def test_stillness_detector_returns_mean_of_readings():
    assert after([(0.0, 10, 0), (0.25, 11, 2), (0.5, 15, 4)]).mean_ticks() == {1: 12.0, 2: 2.0}


def test_restarted_stillness_detector_waits_half_a_second_again():
    still = after([(0.0, 7, 9), (0.25, 7, 9), (0.5, 7, 9)]).restarted()
    assert not still.add_reading(0.6, {1: 7, 2: 9}).is_at_rest()
    for at_s in (0.6, 0.85, 1.1):
        still = still.add_reading(at_s, {1: 7, 2: 9})
    assert still.is_at_rest()


class ManualClock:
    time_s = 0.0

    def now_s(self):
        return self.time_s

    def sleep_until(self, deadline_s):
        self.time_s = deadline_s


@pytest.mark.parametrize(("readings", "until_s"), [(2, 0.5), (3, 0.5), (5, 0.5)])
def test_wait_for_rest_ends_once_joints_rest_for_the_window(readings, until_s):
    clock, detector = ManualClock(), StillnessDetector(0.5, 4, readings)
    still = read_until_at_rest(detector, lambda: [7.0, 9.0], clock, 10.0)
    assert (len(still.readings), clock.time_s, still.joints) == (readings, until_s, [7.0, 9.0])


def test_wait_for_rest_of_moving_joints_ends_at_time_out():
    clock, detector = ManualClock(), StillnessDetector(0.5, 4, 2)
    still = read_until_at_rest(detector, lambda: [100 * clock.time_s], clock, 3.0)
    assert clock.time_s == 3.0
    assert still.has_moved()
    assert not still.is_at_rest()


def test_wait_for_rest_ends_early_if_condition_is_met():
    clock, detector = ManualClock(), StillnessDetector(0.5, 4, 2)
    moves = StillnessDetector.has_moved
    still = read_until_at_rest(detector, lambda: [100 * clock.time_s], clock, 3.0, moves)
    assert clock.time_s == 0.5
    assert still.variations() == [50.0]


def test_zero_stillness_window_compares_two_readings():
    still = StillnessDetector(0.0, 4, 2).add_joints(1.0, [0]).add_joints(2.0, [9])
    assert not still.is_at_rest()
    assert still.add_joints(2.0, [7]).is_at_rest()


def test_stillness_accepts_readings_exactly_a_window_apart():
    for start_s in (0.1, 0.4, 1e5 + 0.7):  # 0.7 - 0.4 is less than 0.3
        still = StillnessDetector(window_s=0.3, tolerance=1.0, least_readings=2)
        still = still.add_joints(start_s, [0.0])
        assert still.add_joints(start_s + 0.3, [0.0]).is_at_rest()
