"""A signal in mid-motion brakes the arm, which holds, and the program is told."""

import signal

import pytest

import ikservo
from ikservo.control.stop_requests import exiting_on_signals
from ikservo.errors import IkservoError, RefusedError, StoppedError
from tests.arm.simulated import clock_of, line_of, registers


@pytest.fixture
def arm():
    with ikservo.open_arm("so101", port="sim") as machine:
        yield machine


def strike(number, at_s=0.4):
    """Return a callback that sends this process a signal at a time of the motion, once."""
    struck = []

    def watch(progress):
        if progress.elapsed_s > at_s and not struck:
            struck.append(progress.elapsed_s)
            signal.raise_signal(number)

    return watch


@pytest.mark.sample(1)
@pytest.mark.parametrize(
    ("number", "ends", "words"),
    [
        (signal.SIGINT, KeyboardInterrupt("Stopped; torque stays on."), "Stopped; torque stays on"),
        (signal.SIGTERM, SystemExit(143), "SIGTERM"),
        (signal.SIGHUP, SystemExit(129), "terminal was closed"),
    ],
)
def test_signal_brakes_arm_which_then_holds(arm, number, ends, words):
    with pytest.raises(type(ends)) as caught:
        arm.move_joints({"shoulder_pan": 1.2}, on_progress=strike(number))
    assert caught.value.args == ends.args
    assert words in arm.stopped_for
    assert all(registers(arm, "torque_enable").values())
    assert abs(registers(arm, "present_position")[1] - 2048) < 600


def test_arm_is_at_rest_within_300_ms_after_signal(arm):
    clock, times = clock_of(arm), []

    def watch(progress):
        if progress.elapsed_s > 0.6 and not times:
            times.append(clock.now_s())
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        arm.move_joints({"shoulder_pan": 1.4}, speed="fast", on_progress=watch)
    assert clock.now_s() - times[0] <= 0.3
    clock.sleep_until(times[0] + 0.4)
    before = registers(arm, "present_position")[1]
    clock.sleep_until(times[0] + 1.0)
    assert abs(registers(arm, "present_position")[1] - before) <= 2


@pytest.mark.full
def test_signal_handler_installed_by_program_is_kept(arm):
    handled = []
    before = signal.signal(signal.SIGTERM, lambda *_: handled.append(True))
    try:
        arm.move_joints({"shoulder_pan": 0.5}, on_progress=strike(signal.SIGTERM, 0.1))
    finally:
        signal.signal(signal.SIGTERM, before)
    assert handled == [True]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_signal_within_exiting_on_signals_brakes_and_exits(arm, number):
    with pytest.raises(SystemExit) as caught, exiting_on_signals():
        arm.move_joints({"shoulder_pan": 1.2}, on_progress=strike(number))
    assert caught.value.args == (128 + number,)
    assert arm.stopped_for.startswith("Stopped b")


def test_signal_handlers_are_restored_after_motion(arm):
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    arm.move_joints({"shoulder_pan": 0.1})
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before


@pytest.mark.full
def test_motion_stopped_by_signal_needs_acknowledgement(arm):
    with pytest.raises(KeyboardInterrupt):
        arm.move_joints({"shoulder_pan": 1.2}, on_progress=strike(signal.SIGINT))
    with pytest.raises(RefusedError, match="acknowledge"):
        arm.move_joints({"shoulder_pan": 0.2})
    arm.acknowledge()
    assert arm.move_joints({"shoulder_pan": 0.2}).reached


def go_on_whatever_happens(arm, pans, number, gone_to):
    for pan in pans:
        gone_to.append(pan)
        try:
            arm.move_joints({"shoulder_pan": pan}, on_progress=strike(number))
        except IkservoError:
            arm.acknowledge()


@pytest.mark.sample(1)
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_signal_ends_program_that_catches_all_ikservo_errors(arm, number):
    gone_to = []
    with pytest.raises((KeyboardInterrupt, SystemExit)):
        go_on_whatever_happens(arm, (1.2, -1.2), number, gone_to)
    assert gone_to == [1.2]


def test_stop_call_raises_stopped_error_with_exit_code_130(arm):
    def watch(progress):
        if progress.elapsed_s > 0.4:
            arm.stop("enough")

    with pytest.raises(StoppedError, match="enough") as caught:
        arm.move_joints({"shoulder_pan": 1.2}, on_progress=watch)
    assert caught.value.exit_code == 130


def test_ctrl_c_during_braking_raises_keyboard_interrupt(arm):
    def watch(progress):
        if progress.elapsed_s > 0.4 and not arm.stop_requests:
            arm.stop("enough")
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        arm.move_joints({"shoulder_pan": 1.2}, on_progress=watch)


def test_acknowledged_signal_does_not_affect_next_stop(arm):
    with pytest.raises(KeyboardInterrupt):
        arm.move_joints({"shoulder_pan": 1.2}, on_progress=strike(signal.SIGINT))
    arm.acknowledge()
    with pytest.raises(StoppedError, match="enough"):
        arm.move_joints({"shoulder_pan": -0.5}, on_progress=lambda _: arm.stop("enough"))


def test_signal_in_with_block_keeps_torque_despite_on_exit_relax():
    arm = ikservo.open_arm("so101", port="sim", on_exit="relax")
    with pytest.raises(KeyboardInterrupt), arm:
        arm.move_joints({"shoulder_pan": 1.2}, on_progress=strike(signal.SIGINT))
    assert all(servo.read("torque_enable") for servo in line_of(arm).servos.values())
