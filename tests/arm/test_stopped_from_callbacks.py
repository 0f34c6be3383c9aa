"""Calls from the callback of a motion: stop, acknowledge, relax, close, fail."""

import threading

import pytest

import ikservo
from ikservo.errors import RefusedError, StoppedError
from tests.arm.simulated import line_of, registers, true_joints


@pytest.fixture(params=["so101", "koch"])
def arm(request):
    with ikservo.open_arm(request.param, port="sim:?pose=home", collisions=False) as machine:
        machine.move_joints({"shoulder_pan": 0.0})
        yield machine


def once(act, after_s=0.4):
    """Return a callback that acts once, in the middle of a motion."""
    done = []

    def check(progress):
        if progress.elapsed_s > after_s and not done:
            done.append(True)
            act()

    return check


def go(arm, act):
    return arm.move_joints({"shoulder_pan": 1.2}, on_progress=once(act))


@pytest.mark.sample(1)
def test_stop_acknowledged_in_callback_still_ends_motion(arm):
    def stop():
        arm.stop()
        arm.acknowledge()

    with pytest.raises(StoppedError):
        go(arm, stop)
    assert true_joints(arm)["shoulder_pan"] < 0.9
    assert arm.stopped_for == ""
    assert arm.move_joints({"shoulder_pan": 0.1}).reached


@pytest.mark.full
@pytest.mark.sample(1)
def test_stop_acknowledged_in_other_thread_still_ends_motion(arm):
    def stop():
        arm.stop()
        arm.acknowledge()

    def from_thread():
        thread = threading.Thread(target=stop)
        thread.start()
        thread.join()

    with pytest.raises(StoppedError):
        go(arm, from_thread)
    assert arm.move_joints({"shoulder_pan": 0.1}).reached


@pytest.mark.sample(1)
def test_second_stop_after_acknowledgement_stays_latched(arm):
    def stop():
        arm.stop("first")
        arm.acknowledge()
        arm.stop("second")

    with pytest.raises(StoppedError):
        go(arm, stop)
    with pytest.raises(RefusedError, match="first"):
        arm.move_joints({"shoulder_pan": 0.1})


@pytest.mark.full
@pytest.mark.sample(1)
def test_acknowledge_in_callback_without_stop_changes_nothing(arm):
    assert go(arm, arm.acknowledge).reached


@pytest.mark.sample(1)
def test_closing_arm_in_callback_ends_motion_and_holds(arm):
    line = line_of(arm)
    with pytest.raises(StoppedError, match="closed the arm during a motion") as caught:
        go(arm, arm.close)
    assert "sim:" not in str(caught.value)
    assert all(servo.read("torque_enable") for servo in line.servos.values())


@pytest.mark.sample(1)
def test_torque_off_in_callback_ends_motion_with_limp_arm(arm):
    with pytest.raises(StoppedError, match="switched torque off"):
        go(arm, arm.disable_torque)
    assert not any(registers(arm, "torque_enable").values())


@pytest.mark.sample(1)
def test_closing_with_relax_in_callback_is_refused(arm):
    with pytest.raises(RefusedError, match="is moving"):
        go(arm, lambda: arm.close("relax"))
    assert all(registers(arm, "torque_enable").values())


@pytest.mark.sample(2)
@pytest.mark.parametrize(
    ("error", "words"),
    [
        (MemoryError(), "ran out of memory"),
        (SystemExit(3), "The program ended"),
        (GeneratorExit(), "The program ended"),
        (ValueError("bad frame"), "ValueError: bad frame"),
    ],
)
def test_exception_of_callback_becomes_the_stop_reason(arm, error, words):
    def fail():
        raise error

    with pytest.raises(type(error)):
        go(arm, fail)
    assert words in arm.stopped_for
    assert "()" not in arm.stopped_for
