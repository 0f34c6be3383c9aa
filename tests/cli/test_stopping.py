"""Ctrl-C in mid-motion: the arm holds; a second one lowers it and switches torque off."""

import contextlib
import errno
import signal
import threading

import pytest

from ikservo.arm import open_arm
from ikservo.cli import open_and_confirm
from ikservo.cli.entry_point import main
from ikservo.cli.second_interrupt import second_interrupt_lowers
from ikservo.clock import RealClock
from ikservo.errors import StoppedError
from servosim.clock import VirtualClock
from servosim.faults import Fault
from tests.arm.simulated import line_of


@pytest.fixture
def servos(monkeypatch):
    """Return the simulated servos of the arm that the command opens."""
    opened = {}

    def remember(*words, **options):
        arm = open_arm(*words, **options)
        opened.update(line_of(arm).servos)
        return arm

    monkeypatch.setattr(open_and_confirm, "open_arm", remember)
    return opened


def press(monkeypatch, numbers):
    """Send signals at successive moments of the first motion that a command runs."""
    left = list(numbers)

    @contextlib.contextmanager
    def watched(*_, **__):
        def draw(progress):
            if left and progress.elapsed_s > 0.3 + 0.05 * (len(numbers) - len(left)):
                signal.raise_signal(left.pop(0))

        yield draw

    monkeypatch.setattr("ikservo.cli.commands.joints.motion_progress_bar", watched)


def move():
    return main(["joints", "shoulder_pan=50", "--arm", "so101", "--port", "sim", "--yes"])


def torques(servos):
    return {servo.read("torque_enable") for servo in servos.values()}


def test_ctrl_c_leaves_arm_holding_and_says_how_to_relax(servos, monkeypatch, capsys):
    press(monkeypatch, [signal.SIGINT])
    monkeypatch.setattr("ikservo.clock.RealClock.sleep_until", lambda *_: None)
    assert move() == 130
    result = capsys.readouterr().err
    assert "Stopped; torque stays on." in result
    assert "ikservo relax" in result
    assert torques(servos) == {1}


@pytest.mark.full
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_sigterm_or_sighup_leaves_the_arm_holding(servos, monkeypatch, number):
    press(monkeypatch, [number])
    assert move() == 130
    assert torques(servos) == {1}


class Gone:
    """A terminal that was closed."""

    encoding = "utf-8"

    def isatty(self):
        return False

    def write(self, _):
        raise OSError(errno.EIO, "Input/output error")

    def flush(self):
        raise OSError(errno.EIO, "Input/output error")


def test_closed_terminal_stops_the_motion_and_arm_holds(servos, monkeypatch):
    press(monkeypatch, [signal.SIGHUP])
    monkeypatch.setattr(
        "ikservo.cli.open_and_confirm.print_status", lambda _: None
    )  # said while it was open
    monkeypatch.setattr("sys.stderr", Gone())
    assert move() == 130
    assert torques(servos) == {1}


def test_failing_progress_bar_does_not_hide_a_stop(monkeypatch):
    def stopped_with_a_bar(_):
        try:
            raise StoppedError("Stopped; torque stays on.")
        finally:
            Gone().flush()

    monkeypatch.setattr("ikservo.cli.entry_point._run_command", stopped_with_a_bar)
    assert main(["move"]) == 130


@pytest.mark.sample(1)
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_second_signal_lowers_arm_and_switches_torque_off(servos, monkeypatch, capsys, number):
    press(monkeypatch, [number, number])
    assert move() == 130
    result = capsys.readouterr().err
    assert "Lowering the arm" in result
    assert "holds\n" not in result
    assert result.endswith("Stopped; the arm was lowered and torque is off.\n")
    assert torques(servos) == {0}
    assert abs(servos[2].read("present_position") - 922) < 40  # its rest pose


@pytest.mark.sample(1)
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_second_signal_is_handled_after_arm_has_come_to_rest(servos, monkeypatch, number):
    sleep_until, presses = RealClock.sleep_until, [number]

    def again(clock, deadline_s):
        if presses and threading.current_thread() is threading.main_thread():
            signal.raise_signal(presses.pop())
        else:  # a thread that another test has left
            sleep_until(clock, deadline_s)

    press(monkeypatch, [number])
    monkeypatch.setattr(RealClock, "sleep_until", again)
    assert move() == 130
    assert torques(servos) == {0}


def test_second_signal_does_not_claim_to_have_lowered_stuck_arm():
    with open_arm("so101", port="sim:?pose=home") as arm:
        line_of(arm).faults.add(Fault(kind="stuck", id=2, at_s=line_of(arm).world.time_s))
        with pytest.raises(
            StoppedError, match=r"^Stopped; torque is off\. The arm was not lowered"
        ):
            interrupt_a_motion(arm, PressedAgain(0.9))


class PressedAgain(VirtualClock):
    """A clock during whose wait the user presses Ctrl-C once more."""

    def __init__(self, at_s):
        super().__init__()
        self._at_s = at_s

    def sleep_until(self, deadline_s):
        super().sleep_until(min(deadline_s, self._at_s))
        if deadline_s >= self._at_s:
            raise KeyboardInterrupt


def interrupt_a_motion(arm, clock):
    """Press Ctrl-C in a motion of an arm; a clock measures the wait for a second Ctrl-C."""

    def press_once(progress):
        if progress.elapsed_s > 0.3 and not arm.stop_requests:
            signal.raise_signal(signal.SIGINT)

    with second_interrupt_lowers(arm, clock):
        arm.move_joints({"shoulder_pan": 1.2}, on_progress=press_once)


@pytest.mark.full
@pytest.mark.parametrize(("at_s", "torque"), [(0.9, 0), (1.1, 1)])
def test_second_signal_has_effect_only_within_one_second(at_s, torque):
    with open_arm("so101", port="sim:?pose=home") as arm:
        with pytest.raises(StoppedError):
            interrupt_a_motion(arm, PressedAgain(at_s))
        assert torques(line_of(arm).servos) == {torque}


class Unheard(VirtualClock):
    """A clock that must not be used."""

    def sleep_until(self, deadline_s):
        raise AssertionError("a second signal was waited for")


def stop_a_motion(arm, clock, reason):
    with second_interrupt_lowers(arm, clock):
        arm.move_joints({"shoulder_pan": 1.2}, on_progress=lambda _: arm.stop(reason))


@pytest.mark.parametrize("reason", ["", "Stopped; torque stays on.", "enough"])
def test_stop_without_signal_does_not_wait_for_second_signal(reason):
    with open_arm("so101", port="sim:?pose=home") as arm:
        with pytest.raises(StoppedError):
            stop_a_motion(arm, Unheard(), reason)
        assert torques(line_of(arm).servos) == {1}
