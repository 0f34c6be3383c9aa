"""If commands end, the arm stops 0.3 s after the last."""

import math

import pytest

from ikservo.guard.dead_man import DeadManSwitch


def test_dead_man_switch_never_pressed_has_expired():
    assert DeadManSwitch().expired(0.0)


@pytest.mark.parametrize(("time_s", "expired"), [(5.0, False), (5.25, False), (5.3125, True)])
def test_dead_man_switch_expires_after_300_ms(time_s, expired):
    switch = DeadManSwitch()
    switch.refresh(5.0)
    assert switch.expired(time_s) is expired


def test_dead_man_switch_is_valid_at_exactly_its_timeout():
    switch = DeadManSwitch(timeout_s=0.25)
    switch.refresh(1.0)
    assert not switch.expired(1.25)


def test_dead_man_switch_time_starts_at_latest_refresh():
    switch = DeadManSwitch()
    switch.refresh(5.0)
    switch.refresh(6.0)
    assert not switch.expired(6.25)


@pytest.mark.parametrize("time_s", [4.0, math.nan, math.inf, -math.inf])
def test_dead_man_switch_ignores_old_and_nan_times(time_s):
    switch = DeadManSwitch()
    switch.refresh(5.0)
    switch.refresh(time_s)
    assert not switch.expired(5.25)
    assert switch.expired(6.0)


def test_dead_man_switch_has_expired_at_nan_time():
    switch = DeadManSwitch()
    switch.refresh(5.0)
    assert switch.expired(math.nan)
