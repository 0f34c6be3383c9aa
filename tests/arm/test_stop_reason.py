"""The reason of a stop as a value: programs use its kind, users read its text."""

import contextlib
import signal

import pytest

import ikservo
from ikservo.arm.background_motion import CANCELLED
from ikservo.control.stop_requests import CTRL_C, StopRequest
from ikservo.errors import BusError, LatchedStopError, StoppedError
from ikservo.guard import StopKind, StopReason
from tests.arm.simulated import servo_group


@pytest.fixture
def arm():
    with ikservo.open_arm("so101", port="sim:?pose=home") as opened:
        yield opened


def at(seconds, do):
    """Return a callback that acts once when a motion has run for the given time."""
    left = [do]

    def on_progress(progress):
        if progress.elapsed_s > seconds and left:
            left.pop()()

    return on_progress


def raises(error):
    def raise_it():
        raise error

    return raise_it


STOPS = {
    "sigint": (lambda _: signal.raise_signal(signal.SIGINT), StopKind.CTRL_C),
    "sigterm": (lambda _: signal.raise_signal(signal.SIGTERM), StopKind.TERMINATED),
    "sighup": (lambda _: signal.raise_signal(signal.SIGHUP), StopKind.HANGUP),
    "stop": (lambda arm: arm.stop(), StopKind.PROGRAM),
    "stop with the words of Ctrl-C": (lambda arm: arm.stop(CTRL_C.text), StopKind.PROGRAM),
    "release": (lambda arm: arm.disable_torque(), StopKind.RELEASED),
    "interrupt": (lambda _: raises(KeyboardInterrupt)(), StopKind.CTRL_C),
    "bus": (lambda _: raises(BusError("nothing was heard"))(), StopKind.FAULT),
    "bug": (lambda _: raises(ZeroDivisionError("a bug"))(), StopKind.FAULT),
}


@pytest.mark.sample(3)
@pytest.mark.parametrize(("stop", "kind"), STOPS.values(), ids=STOPS)
def test_each_cause_of_a_stop_has_its_stop_kind(arm, stop, kind):
    with pytest.raises(BaseException):  # noqa: B017, PT011  # which one is another test's
        arm.move_joints({"shoulder_pan": 0.8}, on_progress=at(0.3, lambda: stop(arm)))
    assert arm.stop_reason.kind is kind
    assert arm.stopped_for == arm.stop_reason.text != ""
    arm.acknowledge()
    assert (arm.stop_reason, arm.stopped_for) == (None, "")


def test_stop_by_signal_before_first_goal_is_reported_as_signal(arm, monkeypatch):
    streaming = servo_group(arm).streaming

    @contextlib.contextmanager
    def interrupted(*speeds):
        signal.raise_signal(signal.SIGTERM)
        with streaming(*speeds):
            yield

    monkeypatch.setattr(servo_group(arm), "streaming", interrupted)
    with pytest.raises(SystemExit):
        arm.move_joints({"shoulder_pan": 0.8})
    assert arm.stop_reason.kind is StopKind.TERMINATED


def test_cancel_does_not_replace_program_stop_of_same_text(arm):
    arm.stop(CANCELLED.text)
    motion = arm.move_joints({"shoulder_pan": 0.8}, wait=False)
    motion.cancel()
    motion.join()
    assert arm.stop_reason.kind is StopKind.PROGRAM


def test_repeated_stop_keeps_first_reason_and_is_counted():
    request = StopRequest()
    assert not request
    request.set(CTRL_C, signal=2)
    request.set(StopReason(StopKind.PROGRAM, "enough"))
    assert (request.reason, request.signal, request.times) == (CTRL_C, 2, 2)
    with pytest.raises(StoppedError, match="torque stays on"):
        request.raise_if_set()
    request.raise_if_without_braking()
    request.clear()
    request.raise_if_set()
    assert (request.reason, request.signal, request.times) == (None, 0, 0)


def test_stop_request_without_braking_has_given_hint():
    request = StopRequest()
    request.set_without_braking(StopReason(StopKind.CLOSED, "closed"), "Open it again.")
    with pytest.raises(StoppedError, match="closed") as caught:
        request.raise_if_without_braking()
    assert caught.value.hint == "Open it again."


@pytest.mark.parametrize(
    ("text", "headline"), [("", "no reason was given"), ("heat\nof the elbow", "heat")]
)
def test_stop_reason_summary_is_one_line(text, headline):
    assert StopReason(StopKind.FAULT, text).headline == headline


def test_stop_with_empty_reason_text_still_stops(arm):
    arm.stop(reason=10**5000)
    with pytest.raises(LatchedStopError, match="a value of type int"):
        arm.move_joints({"gripper": 0.1})
