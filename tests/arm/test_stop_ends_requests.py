"""A stop ends every motion that was requested before it, whenever it is acknowledged."""

import threading

import pytest

import ikservo
from ikservo.arm import StopKind, StopReason
from ikservo.errors import RefusedError, StoppedError
from tests.arm.simulated import call_before, line_of, motion_runner, registers, servo_group

STROKES_M = [[(0.22, -0.03, 0.12), (0.22, 0.03, 0.12)], [(0.25, 0.03, 0.12), (0.25, -0.03, 0.12)]]
REQUESTS = {
    "move_to": lambda arm: arm.move_to((0.25, 0.05, 0.15)),
    "move_line": lambda arm: arm.move_line((0.22, 0.05, 0.15)),
    "draw": lambda arm: arm.draw(STROKES_M),
    "pose": lambda arm: arm.pose("zero"),
    "gripper": lambda arm: arm.gripper("open"),
    "jog": lambda arm: arm.jog("shoulder_pan", 0.1, wanted=lambda: True),
}


@pytest.fixture
def arm():
    with ikservo.open_arm("so101", port="sim") as opened:
        opened.pose("home")
        yield opened


def stop_and_acknowledge(arm):
    arm.stop()
    arm.acknowledge()


@pytest.mark.sample(2)
@pytest.mark.parametrize("request_motion", REQUESTS.values(), ids=REQUESTS)
def test_stop_during_motion_preparation_ends_motion(arm, monkeypatch, request_motion):
    before = registers(arm, "goal_position")
    done = call_before(motion_runner(arm), "motion", monkeypatch, lambda: stop_and_acknowledge(arm))
    with pytest.raises(StoppedError):
        request_motion(arm)
    assert done
    assert registers(arm, "goal_position") == before
    assert arm.stop_reason is None


def test_stop_during_torque_on_ends_the_motion(monkeypatch):
    with ikservo.open_arm("so101", port="sim") as arm:
        call_before(servo_group(arm), "enable", monkeypatch, lambda: stop_and_acknowledge(arm))
        before = arm.where().positions_rad
        with pytest.raises(StoppedError):
            arm.pose("home")
        assert abs(arm.where().positions_rad - before).max() < 0.05  # it sags


@pytest.mark.full
@pytest.mark.sample(1)
@pytest.mark.parametrize("method", ["refresh_reference", "reference", "goals"])
def test_stop_acknowledged_between_motion_parts_ends_motion(arm, monkeypatch, method):
    before = registers(arm, "goal_position")
    call_before(servo_group(arm), method, monkeypatch, lambda: stop_and_acknowledge(arm))
    with pytest.raises(StoppedError):
        arm.move_joints({"shoulder_pan": 0.2})
    assert registers(arm, "goal_position") == before


@pytest.mark.full
def test_stop_ends_queued_motions_even_if_acknowledged(arm):
    with motion_runner(arm).lock:  # the first cannot start before all are queued
        motions = [arm.move_joints({"shoulder_pan": x}, wait=False) for x in (0.2, -0.2, 0.2)]
        stop_and_acknowledge(arm)
    for motion in motions:
        with pytest.raises(StoppedError):
            motion.wait()
    assert abs(arm.where()["shoulder_pan"].position_rad) < 0.01


@pytest.mark.full
def test_cancelled_motion_does_not_end_next_motion(arm):
    with motion_runner(arm).lock:
        first, second = (arm.move_joints({"shoulder_pan": x}, wait=False) for x in (0.2, 0.3))
        first.cancel()
    second.wait()
    assert arm.where()["shoulder_pan"].position_rad == pytest.approx(0.3, abs=0.02)


def test_motion_requested_after_stop_runs(arm):
    stop_and_acknowledge(arm)
    assert arm.pose("zero").reached


@pytest.mark.full
def test_motion_requested_while_stopped_motion_brakes_is_run(arm):
    later = []

    def stop_and_go_on(progress):
        if not later and progress.elapsed_s > 0.2:
            stop_and_acknowledge(arm)
            later.append(arm.move_joints({"shoulder_pan": 0.3}, wait=False))

    with pytest.raises(StoppedError):
        arm.move_joints({"shoulder_pan": -0.5}, on_progress=stop_and_go_on)
    assert later[0].wait().reached


@pytest.mark.full
def test_stop_during_plan_check_ends_its_execution(arm, monkeypatch):
    plan = arm.plan_joints({"shoulder_pan": 0.3})
    stop_and_acknowledge(arm)  # its torque is read again before the next motion
    before = registers(arm, "goal_position")
    call_before(arm.context.collision, "check_path", monkeypatch, lambda: stop_and_acknowledge(arm))
    with pytest.raises(StoppedError):
        arm.execute(plan)
    assert registers(arm, "goal_position") == before


@pytest.mark.full
def test_stop_between_two_program_steps_ends_program(arm):
    with arm.background.requested():
        arm.move_joints({"shoulder_pan": 0.1})
        stop_and_acknowledge(arm)
        with pytest.raises(StoppedError):
            arm.move_joints({"shoulder_pan": 0.2})


@pytest.mark.full
def test_stop_at_rest_cancels_earlier_motion_requests(arm):
    with motion_runner(arm).lock:
        motion = arm.move_joints({"shoulder_pan": 0.2}, wait=False)
        reason = StopReason(StopKind.CLIENT, "Stopped by another program.")
        threading.Thread(target=lambda: motion_runner(arm).stop_servos(reason)).run()
        arm.acknowledge()
    with pytest.raises(StoppedError):
        motion.wait()


@pytest.mark.full
def test_refused_motion_after_stop_sends_nothing(arm):
    old_plan = arm.plan_to((0.25, 0.05, 0.15))
    arm.pose("zero")
    stop_and_acknowledge(arm)
    arm.where()  # the last goal of the motion is on the line until somebody listens
    line_of(arm).witnesses.append(witness := WriteWitness())
    for refused in (
        lambda: arm.move_to((0.25, 0.0, -0.1)),
        lambda: arm.move_joints({"shoulder_lift": 9.0}),
        lambda: arm.execute(old_plan),
    ):
        with pytest.raises(RefusedError):
            refused()
    arm.where()
    assert not witness.frames


class WriteWitness:
    """Collects the frames that write to servos."""

    def __init__(self):
        self.frames = []

    def on_frame(self, at_s, frame, framing):
        if frame.instruction in (0x03, 0x83):  # write, sync write
            self.frames.append(frame)

    def on_reply(self, at_s, servo, data):
        pass
