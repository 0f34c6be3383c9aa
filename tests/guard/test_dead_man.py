"""Commands that stop coming are a stop, 0.3 s after the last."""

import math

import pytest

from ikservo.guard import DeadMan


def test_a_switch_that_nobody_ever_pressed_has_expired():
    assert DeadMan().check(0.0)


@pytest.mark.parametrize(("time_s", "expired"), [(5.0, False), (5.25, False), (5.3125, True)])
def test_a_command_lasts_for_three_tenths_of_a_second(time_s, expired):
    switch = DeadMan()
    switch.fresh(5.0)
    assert switch.check(time_s) is expired


def test_exactly_as_long_as_given_is_in_time():
    switch = DeadMan(timeout_s=0.25)
    switch.fresh(1.0)
    assert not switch.check(1.25)


def test_each_command_counts_from_its_own_time():
    switch = DeadMan()
    switch.fresh(5.0)
    switch.fresh(6.0)
    assert not switch.check(6.25)


@pytest.mark.parametrize("time_s", [4.0, math.nan, math.inf, -math.inf])
def test_an_old_command_and_one_without_a_time_press_nothing(time_s):
    switch = DeadMan()
    switch.fresh(5.0)
    switch.fresh(time_s)
    assert not switch.check(5.25)
    assert switch.check(6.0)


def test_who_does_not_know_the_time_has_no_command():
    switch = DeadMan()
    switch.fresh(5.0)
    assert switch.check(math.nan)
