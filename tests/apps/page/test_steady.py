"""What a view asks of the interpreter, and gives back."""

import gc
import sys

import pytest

from ikservo.apps.page.page_app import low_jitter


def test_threads_take_turns_often_while_a_view_is_open_and_as_before_afterwards():
    before = sys.getswitchinterval()
    with low_jitter():
        assert sys.getswitchinterval() < before
    assert sys.getswitchinterval() == before


@pytest.mark.full
def test_what_is_loaded_is_not_looked_at_by_the_collector_while_a_view_is_open():
    with low_jitter():
        assert gc.get_freeze_count() > 10_000
    assert gc.get_freeze_count() == 0
