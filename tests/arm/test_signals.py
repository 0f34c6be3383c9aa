"""Signals in the middle of a motion: the arm is braked, holds, and the program is told."""

import signal

import pytest

import ikservo
from ikservo.errors import RefusedError, StoppedError
from tests.arm.simulated import line_of, registers


@pytest.fixture
def arm():
    with ikservo.open_arm("so101", port="sim") as machine:
        yield machine


def strike(number, at_s=0.4):
    """Return what sends this process a signal at a time of the motion, once."""
    struck = []

    def watch(progress):
        if progress.elapsed_s > at_s and not struck:
            struck.append(progress.elapsed_s)
            signal.raise_signal(number)

    return watch


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (signal.SIGINT, "Stopped; the arm holds"),
        (signal.SIGTERM, "SIGTERM"),
        (signal.SIGHUP, "terminal was closed"),
    ],
)
def test_a_signal_brakes_the_arm_and_leaves_it_holding(arm, number, words):
    with pytest.raises(StoppedError, match=words) as caught:
        arm.move_joints({"shoulder_pan": 1.2}, on_progress=strike(number))
    assert caught.value.exit_code == 130
    assert "ikservo relax" in caught.value.hint
    assert all(registers(arm, "torque_enable").values())
    assert abs(registers(arm, "present_position")[1] - 2048) < 600


def test_the_arm_stands_within_0_3_s_of_a_signal(arm):
    clock, times = arm._port.clock, []

    def watch(progress):
        if progress.elapsed_s > 0.6 and not times:
            times.append(clock.now_s())
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(StoppedError):
        arm.move_joints({"shoulder_pan": 1.4}, speed="fast", on_progress=watch)
    assert clock.now_s() - times[0] <= 0.3
    clock.sleep_until(times[0] + 0.4)
    before = registers(arm, "present_position")[1]
    clock.sleep_until(times[0] + 1.0)
    assert abs(registers(arm, "present_position")[1] - before) <= 2


def test_a_program_that_has_its_own_handler_keeps_it(arm):
    heard = []
    before = signal.signal(signal.SIGTERM, lambda *_: heard.append(True))
    try:
        arm.move_joints({"shoulder_pan": 0.5}, on_progress=strike(signal.SIGTERM, 0.1))
    finally:
        signal.signal(signal.SIGTERM, before)
    assert heard == [True]


def test_handlers_are_as_before_once_the_motion_is_over(arm):
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    arm.move_joints({"shoulder_pan": 0.1})
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before


def test_what_a_signal_has_stopped_stays_stopped_in_this_program(arm):
    with pytest.raises(StoppedError):
        arm.move_joints({"shoulder_pan": 1.2}, on_progress=strike(signal.SIGINT))
    with pytest.raises(RefusedError, match="acknowledge"):
        arm.move_joints({"shoulder_pan": 0.2})
    arm.acknowledge()
    assert arm.move_joints({"shoulder_pan": 0.2}).reached


def test_leaving_the_block_after_a_signal_keeps_torque_whatever_the_way_to_exit():
    arm = ikservo.open_arm("so101", port="sim", on_exit="relax")
    with pytest.raises(StoppedError), arm:
        arm.move_joints({"shoulder_pan": 1.2}, on_progress=strike(signal.SIGINT))
    assert all(servo.read("torque_enable") for servo in line_of(arm).servos.values())
