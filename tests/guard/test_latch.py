"""A stop stays until somebody acknowledges it, and remembers its cause."""

import pytest

from ikservo.errors import ExitCode, RefusedError
from ikservo.guard import Latch, StopKind, StopReason

HEAT = StopReason(StopKind.FAULT, "heat")
SILENCE = StopReason(StopKind.FAULT, "silence")


def test_a_latch_that_was_never_latched_lets_everything_pass():
    Latch().check()
    assert Latch().reason is None


def test_a_latched_stop_says_why_in_one_line():
    latch = Latch()
    latch.latch_stop(StopReason(StopKind.UNPLUGGED, "The cable is gone.\nPlug it in."))
    with pytest.raises(RefusedError) as caught:
        latch.check()
    assert caught.value.message == "The arm was stopped: The cable is gone."
    assert caught.value.exit_code == ExitCode.REFUSED


def test_the_first_reason_stays():
    latch = Latch()
    latch.latch_stop(HEAT)
    latch.latch_stop(SILENCE)
    assert latch.reason is HEAT


def test_a_stop_without_a_reason_is_a_stop():
    latch = Latch()
    latch.latch_stop(StopReason(StopKind.PROGRAM))
    with pytest.raises(RefusedError, match="stopped"):
        latch.check()


def test_once_acknowledged_everything_passes_again():
    latch = Latch()
    latch.latch_stop(HEAT)
    assert latch.acknowledge() is HEAT
    latch.check()
    assert latch.reason is None
