"""Motions with ``wait=False``: ``done``, ``wait`` and ``cancel``."""

import asyncio
import gc
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

import ikservo
from ikservo.arm.background_motion import Turns
from tests.arm.simulated import clock_of, line_of, registers, servo_id, true_joints, true_tip_m

NEAR = (0.23, 0.02, 0.10)


@pytest.fixture
def arm():
    with ikservo.open_arm("so101", port="sim:?pose=home") as machine:
        yield machine


class Gate:
    """Holds a motion in one of its control cycles until the test opens the gate."""

    def __init__(self, at_s=0.3):
        self.reached, self._open, self._at_s = threading.Event(), threading.Event(), at_s

    def __call__(self, progress):
        if progress.elapsed_s > self._at_s:
            self.reached.set()
            self._open.wait(20.0)

    def open(self):
        self._open.set()


def holding(arm):
    return all(registers(arm, "torque_enable").values())


def begun(arm, pan=0.4, at_s=0.3):
    """Return a motion of the pan that waits in mid-motion, and its gate."""
    gate = Gate(at_s)
    motion = arm.move_joints({"shoulder_pan": pan}, on_progress=gate, wait=False)
    assert gate.reached.wait(20.0)
    return motion, gate


def open_once(gate, condition):
    """Let a motion go on once something has happened."""

    def watch():
        while not condition():
            time.sleep(0.001)
        gate.open()

    threading.Thread(target=watch, daemon=True).start()


def is_waited_for(motion):
    """Return whether the main thread blocks in ``motion.wait``."""
    frame, codes = sys._current_frames()[threading.main_thread().ident], set()
    while frame is not None:
        codes.add(frame.f_code)
        frame = frame.f_back
    return {type(motion).wait.__code__, threading.Condition.wait.__code__} <= codes


def test_background_motion_returns_same_report_as_blocking_one(arm):
    motion = arm.move_to(NEAR, wait=False)
    report = motion.wait()
    assert report.reached
    np.testing.assert_allclose(true_tip_m(arm), NEAR, atol=2e-3)
    assert motion.wait() is report


@pytest.mark.full
def test_program_continues_while_arm_moves(arm):
    motion, gate = begun(arm)
    assert not motion.done
    gate.open()
    motion.wait()
    assert motion.done


@pytest.mark.sample(2)
@pytest.mark.parametrize(
    "start",
    [
        lambda arm: arm.move_to(NEAR, wait=False),
        lambda arm: arm.move_line(arm.where().tip_m + np.array([0, 0, 0.02]), wait=False),
        lambda arm: arm.move_through([(0.22, 0.01, 0.09), NEAR], wait=False),
        lambda arm: arm.move_joints({"shoulder_pan": 0.2}, wait=False),
        lambda arm: arm.pose("home", wait=False),
        lambda arm: arm.gripper("open", wait=False),
    ],
)
def test_every_motion_runs_in_background_with_wait_false(arm, start):
    assert start(arm).wait().reached


@pytest.mark.full
def test_a_recording_is_replayed_in_the_background(arm, tmp_path):
    arm.enable()
    arm.record(tmp_path / "still.jsonl", duration_s=0.2)
    assert arm.replay(tmp_path / "still.jsonl", wait=False).wait().error_rad < 0.02


@pytest.mark.parametrize(
    ("start", "error"),
    [
        (lambda arm: arm.move_to((0.9, 0, 0), wait=False), ikservo.UnreachableError),
        (lambda arm: arm.move_joints({"elbow_flex": 9.0}, wait=False), ikservo.RefusedError),
        (lambda arm: arm.pose("nowhere", wait=False), ikservo.UnknownNameError),
    ],
)
def test_wait_raises_motion_error_on_every_call(arm, start, error):
    motion = start(arm)
    for _ in range(2):
        with pytest.raises(error):
            motion.wait()
    assert motion.done


def test_wait_raises_fault_that_occurs_during_motion(arm):
    pan = line_of(arm).servos[servo_id("so101", "shoulder_pan")]

    def jam(progress):
        if progress.elapsed_s > 0.3:
            pan.motor.stuck = True

    motion = arm.move_joints({"shoulder_pan": 1.5}, on_progress=jam, wait=False)
    with pytest.raises(ikservo.RefusedError, match="shoulder_pan does not follow"):
        motion.wait()


@pytest.mark.campaign
def test_motion_continues_after_time_out_of_wait(arm):
    motion, gate = begun(arm)
    with pytest.raises(TimeoutError, match="not over"):
        motion.wait(0.05)
    gate.open()
    assert motion.wait(60.0).reached


def test_cancelled_motion_brakes_in_300_ms_and_holds(arm):
    clock, times = clock_of(arm), []
    motion, gate = begun(arm, pan=1.6, at_s=0.6)
    times.append(clock.now_s())
    motion.cancel()
    gate.open()
    with pytest.raises(ikservo.StoppedError, match="Cancelled"):
        motion.wait()
    assert clock.now_s() - times[0] <= 0.3
    assert holding(arm)
    assert true_joints(arm)["shoulder_pan"] < 1.4


def test_motion_runs_after_cancel_without_acknowledgement(arm):
    motion, gate = begun(arm)
    motion.cancel()
    gate.open()
    motion.join()
    assert arm.stopped_for == ""
    assert arm.move_joints({"shoulder_pan": 0.1}).reached


def test_stop_during_cancel_stays_until_acknowledged(arm):
    motion, gate = begun(arm)
    motion.cancel()
    arm.stop("the door was opened")
    gate.open()
    with pytest.raises(ikservo.StoppedError):
        motion.wait()
    with pytest.raises(ikservo.RefusedError):
        arm.move_joints({"shoulder_pan": 0.1})


@pytest.mark.full
def test_cancelling_finished_motion_changes_nothing(arm):
    motion = arm.move_joints({"shoulder_pan": 0.1}, wait=False)
    motion.wait()
    motion.cancel()
    assert motion.wait().reached
    assert arm.stopped_for == ""


@pytest.mark.full
def test_motion_cancelled_in_queue_never_moves(arm):
    first, gate = begun(arm)
    second = arm.move_joints({"wrist_roll": 1.0}, wait=False)
    second.cancel()
    gate.open()
    assert first.wait().reached
    with pytest.raises(ikservo.StoppedError, match="Cancelled"):
        second.wait()
    assert abs(true_joints(arm)["wrist_roll"]) < 0.01


@pytest.mark.full
def test_background_motions_run_one_after_another(arm):
    motions = [arm.move_joints({"shoulder_pan": pan}, wait=False) for pan in (0.1, -0.1, 0.05)]
    assert all(motion.wait().reached for motion in motions)
    assert true_joints(arm)["shoulder_pan"] == pytest.approx(0.05, abs=0.01)


def test_motions_run_in_the_order_of_their_requests():
    turns, order = Turns(), []

    def run(holder):
        with turns.hold(holder), turns.hold():
            order.append(holder)

    for holder in "abc":
        turns.enqueue(holder)
    threads = [threading.Thread(target=run, args=holder, daemon=True) for holder in "cba"]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(20.0)
    assert order == ["a", "b", "c"]


def test_thread_that_cannot_start_leaves_the_queue(arm, monkeypatch):
    def refuse(thread):
        raise RuntimeError("can't start new thread")

    with monkeypatch.context() as patch:
        patch.setattr(threading.Thread, "start", refuse)
        with pytest.raises(RuntimeError, match="new thread"):
            arm.move_joints({"shoulder_pan": 0.1}, wait=False)
    assert arm.move_joints({"shoulder_pan": 0.1}).reached


def test_ctrl_c_as_a_motion_starts_does_not_give_its_turn_away(arm, monkeypatch):
    start = threading.Thread.start

    def start_and_interrupt(thread):
        start(thread)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(threading.Thread, "start", start_and_interrupt)
        with pytest.raises(KeyboardInterrupt):
            arm.move_joints({"shoulder_pan": 0.1}, wait=False)
    assert arm.move_joints({"wrist_roll": 0.1}).reached
    assert true_joints(arm)["shoulder_pan"] == pytest.approx(0.1, abs=0.01)


@pytest.mark.full
def test_blocking_motion_waits_for_background_motion(arm):
    motion, gate = begun(arm, pan=0.3)
    threading.Timer(0.1, gate.open).start()
    assert arm.move_joints({"wrist_roll": 0.2}).reached
    assert motion.done


@pytest.mark.campaign
def test_motions_started_by_two_threads_run_one_after_another(arm):
    reports = []

    def move(joint):
        reports.append(arm.move_joints({joint: 0.3}))

    threads = [threading.Thread(target=move, args=(j,)) for j in ("shoulder_pan", "wrist_roll")]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60.0)
    assert [report.reached for report in reports] == [True, True]


@pytest.mark.full
def test_where_method_returns_during_motion(arm):
    motion, gate = begun(arm, pan=0.5)
    here = arm.where()
    assert 0.0 < here["shoulder_pan"].position_rad < 0.5
    assert here.torque.all()
    gate.open()
    motion.wait()


def test_closing_arm_cancels_running_and_queued_motions(arm):
    running, gate = begun(arm)
    waiting = arm.move_joints({"wrist_roll": 1.0}, wait=False)
    open_once(gate, lambda: running.cancelled and waiting.cancelled)
    arm.close()
    for motion in (running, waiting):
        with pytest.raises(ikservo.StoppedError, match="Cancelled"):
            motion.wait(0.0)
    assert holding(arm)


def test_error_in_with_block_cancels_motion_and_holds():
    arm = ikservo.open_arm("so101", port="sim:?pose=home", on_exit="relax")
    motion, gate = begun(arm)
    open_once(gate, lambda: motion.cancelled)
    with pytest.raises(ZeroDivisionError), arm:
        raise ZeroDivisionError
    assert motion.done
    assert holding(arm)


def test_motion_refuses_wait_from_its_own_callback(arm):
    found = []

    def wait_here(_):
        try:
            handle[0].wait()
        except ikservo.RefusedError as error:
            found.append(error.message)

    handle = [arm.move_joints({"shoulder_pan": 0.1}, on_progress=wait_here, wait=False)]
    handle[0].wait()
    assert "wait for itself" in found[-1]


@pytest.mark.parametrize("reached", [threading.main_thread, threading.current_thread])
@pytest.mark.parametrize(
    ("number", "ends"), [(signal.SIGINT, KeyboardInterrupt), (signal.SIGTERM, SystemExit)]
)
def test_signal_during_wait_brakes_arm_and_ends_program(arm, caplog, number, ends, reached):
    """The signal may reach the waiting thread or another one, which does not end the wait."""
    motion, gate = begun(arm, pan=1.6)

    def strike():
        while not is_waited_for(motion):
            time.sleep(0.001)
        signal.pthread_kill(reached().ident, number)

    threading.Thread(target=strike).start()
    open_once(gate, lambda: arm.stop_requests)
    with pytest.raises(ends):
        motion.wait()
    assert motion.done
    assert holding(arm)
    assert true_joints(arm)["shoulder_pan"] < 1.4
    motion.__del__()  # the program drops it
    assert caplog.text == ""


def test_signal_outside_wait_brakes_arm(arm):
    motion, gate = begun(arm, pan=1.6)
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)
    gate.open()
    assert motion.join(60.0)
    assert holding(arm)
    assert true_joints(arm)["shoulder_pan"] < 1.4


@pytest.mark.full
def test_signal_handlers_are_restored_after_motions(arm):
    arm.move_joints({"shoulder_pan": 0.1}, wait=False).wait()
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)
    assert arm.stopped_for == ""
    assert arm.move_joints({"shoulder_pan": 0.0}).reached
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


LEFT_BEHIND = """
import atexit, threading
def tell():  # after whatever ikservo does at the end of a program
    print(motion.done, arm.stopped_for, {s.read("torque_enable") for s in servos.values()})
atexit.register(tell)
import ikservo
arm = ikservo.open_arm("so101", port="sim:?pose=home&paced=1")
servos, began = arm.context.port.transport.line.servos, threading.Event()
arm.enable()
motion = arm.move_joints({"shoulder_pan": 1.6}, on_progress=lambda _: began.set(), wait=False)
began.wait(60)
"""


@pytest.mark.full
def test_arm_is_braked_before_program_exits_during_motion():
    ran = subprocess.run([sys.executable, "-c", LEFT_BEHIND], capture_output=True, text=True,
                         check=False, timeout=100)  # fmt: skip
    assert (ran.returncode, ran.stderr) == (0, "")
    assert ran.stdout.strip() == "True  {1}"


def test_asyncio_program_awaits_motion(arm):
    async def main():
        report = await arm.move_joints({"shoulder_pan": 0.2}, wait=False)
        return report.reached

    assert asyncio.run(main())


def test_cancelling_a_task_cancels_its_motion(arm):
    motion, gate = begun(arm)

    async def main():
        async def move():
            await motion

        task = asyncio.create_task(move())
        await asyncio.sleep(0)  # the task begins to wait
        task.cancel()
        open_once(gate, lambda: motion.cancelled)
        with pytest.raises(asyncio.CancelledError):
            await task

    asyncio.run(main())
    assert motion.cancelled
    assert motion.done


@pytest.mark.full
def test_background_motion_error_without_wait_is_logged(arm, caplog):
    motion = arm.move_to((0.9, 0.0, 0.1), wait=False)
    motion.join()
    arm.close()
    with ikservo.open_arm("so101", port="sim:?pose=home") as other:
        other.gripper("open", wait=False).wait()  # whatever is watched for signals is looked at
    del motion
    end_s = time.monotonic() + 10.0
    while "nobody waited for" not in caplog.text and time.monotonic() < end_s:
        gc.collect()  # the thread of the motion may still be about to end
        time.sleep(0.01)
    assert "nobody waited for" in caplog.text


@pytest.mark.full
@pytest.mark.parametrize("timeout", ["soon", [1]])
def test_wait_refuses_time_out_that_is_not_a_number(arm, timeout):
    motion = arm.move_joints({"shoulder_pan": 0.1}, wait=False)
    with pytest.raises(ikservo.BadValueError):
        motion.wait(timeout)
    assert motion.wait().reached
