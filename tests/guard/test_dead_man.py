"""Commands that stop coming are a stop, 0.3 s after the last."""

import math

import pytest

from ikservo.guard import DeadManSwitch


def test_a_dead_man_switch_never_pressed_has_expired():
    assert DeadManSwitch().expired(0.0)


@pytest.mark.parametrize(("time_s", "expired"), [(5.0, False), (5.25, False), (5.3125, True)])
def test_a_command_lasts_for_three_tenths_of_a_second(time_s, expired):
    switch = DeadManSwitch()
    switch.refresh(5.0)
    assert switch.expired(time_s) is expired


def test_exactly_as_long_as_given_is_in_time():
    switch = DeadManSwitch(timeout_s=0.25)
    switch.refresh(1.0)
    assert not switch.expired(1.25)


def test_each_command_counts_from_its_own_time():
    switch = DeadManSwitch()
    switch.refresh(5.0)
    switch.refresh(6.0)
    assert not switch.expired(6.25)


@pytest.mark.parametrize("time_s", [4.0, math.nan, math.inf, -math.inf])
def test_an_old_command_and_one_without_a_time_press_nothing(time_s):
    switch = DeadManSwitch()
    switch.refresh(5.0)
    switch.refresh(time_s)
    assert not switch.expired(5.25)
    assert switch.expired(6.0)


def test_who_does_not_know_the_time_has_no_command():
    switch = DeadManSwitch()
    switch.refresh(5.0)
    assert switch.expired(math.nan)
