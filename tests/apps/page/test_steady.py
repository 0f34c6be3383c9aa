"""A view changes settings of the interpreter and restores them."""

import gc
import sys

import pytest

from ikservo.apps.page.page_app import low_jitter


def test_thread_switch_interval_is_shorter_while_panel_is_open():
    before = sys.getswitchinterval()
    with low_jitter():
        assert sys.getswitchinterval() < before
    assert sys.getswitchinterval() == before


@pytest.mark.full
def test_garbage_collector_is_frozen_while_panel_is_open():
    with low_jitter():
        assert gc.get_freeze_count() > 10_000
    assert gc.get_freeze_count() == 0
