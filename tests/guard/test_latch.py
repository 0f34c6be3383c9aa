"""A stop stays until somebody acknowledges it, and remembers its cause."""

import pytest

from ikservo.errors import ExitCode, RefusedError
from ikservo.guard import Latch


def test_a_latch_that_was_never_tripped_lets_everything_pass():
    Latch().check()
    assert Latch().reason == ""


def test_a_tripped_latch_says_why_in_one_line():
    latch = Latch()
    latch.trip("The cable is gone.\nPlug it in.")
    with pytest.raises(RefusedError) as caught:
        latch.check()
    assert caught.value.message == "The arm was stopped: The cable is gone."
    assert caught.value.exit_code == ExitCode.REFUSED


def test_the_first_reason_stays():
    latch = Latch()
    latch.trip("heat")
    latch.trip("silence")
    assert latch.reason == "heat"


def test_a_stop_without_a_reason_is_a_stop():
    latch = Latch()
    latch.trip("")
    with pytest.raises(RefusedError, match="stopped"):
        latch.check()


def test_once_acknowledged_everything_passes_again():
    latch = Latch()
    latch.trip("heat")
    assert latch.acknowledge() == "heat"
    latch.check()
    assert latch.reason == ""
