"""A stop lasts until it is acknowledged, and remembers its cause."""

import pytest

from ikservo.errors import ExitCode, RefusedError
from ikservo.guard import StopKind, StopLatch, StopReason

HEAT = StopReason(StopKind.FAULT, "heat")
SILENCE = StopReason(StopKind.FAULT, "silence")


def test_unset_stop_latch_raises_nothing():
    StopLatch().raise_if_stopped()
    assert StopLatch().reason is None


def test_stop_latch_error_states_reason_in_one_line():
    latch = StopLatch()
    latch.latch_stop(StopReason(StopKind.UNPLUGGED, "The cable is gone.\nPlug it in."))
    with pytest.raises(RefusedError) as caught:
        latch.raise_if_stopped()
    assert caught.value.message == "The arm was stopped: The cable is gone."
    assert caught.value.exit_code == ExitCode.REFUSED


def test_stop_latch_keeps_first_reason():
    latch = StopLatch()
    latch.latch_stop(HEAT)
    latch.latch_stop(SILENCE)
    assert latch.reason is HEAT


def test_stop_latch_without_message_refuses_commands():
    latch = StopLatch()
    latch.latch_stop(StopReason(StopKind.PROGRAM))
    with pytest.raises(RefusedError, match="stopped"):
        latch.raise_if_stopped()


def test_acknowledged_stop_latch_raises_nothing():
    latch = StopLatch()
    latch.latch_stop(HEAT)
    assert latch.acknowledge() is HEAT
    latch.raise_if_stopped()
    assert latch.reason is None
