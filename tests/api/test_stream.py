"""Setpoints that a program streams at its own rate pass the guard and keep the arm's limits."""

import itertools
import math
import time
from dataclasses import replace

import numpy as np
import pytest

import ikservo
from ikservo.arm.setpoint_stream import SetpointMailbox
from tests.arm.audit import Auditor
from tests.arm.simulated import (
    clock_of,
    context_of,
    line_of,
    registers,
    servo_group,
    servo_id,
    true_joints,
    true_tip_m,
)


@pytest.fixture
def arm():
    with ikservo.open_arm("so101", port="sim:?pose=home") as machine:
        machine.move_joints({"wrist_roll": 0.0})  # the first motion is slow
        yield machine


def joints_of(arm):
    return arm.where().positions_rad


def test_stream_follows_joint_arrays(arm):
    start = joints_of(arm)
    with arm.stream(rate_hz=50) as stream:
        for share in np.linspace(0.0, 1.0, 25):
            stream.send(start + share * np.array([0.1, 0, 0, 0, 0.1, 0]))
    assert stream.sent == 25
    assert true_joints(arm)["shoulder_pan"] == pytest.approx(start[0] + 0.1, abs=0.02)
    assert true_joints(arm)["wrist_roll"] == pytest.approx(start[4] + 0.1, abs=0.02)


def test_stream_is_paced_by_the_clock_of_the_arm(arm):
    clock, start = clock_of(arm), joints_of(arm)
    with arm.stream(rate_hz=50) as stream:
        stream.send(start)
        begun_s = clock.now_s()
        for _ in range(25):
            stream.send(start)
        assert clock.now_s() - begun_s == pytest.approx(0.5, abs=0.06)


def test_stream_of_named_joint_leaves_others_in_place(arm):
    before = true_joints(arm)
    with arm.stream(rate_hz=50) as stream:
        for _ in range(20):
            stream.send({"wrist_roll": 0.15})
    after = true_joints(arm)
    assert after["wrist_roll"] == pytest.approx(0.15, abs=0.02)
    assert all(abs(after[n] - before[n]) < 0.02 for n in before if n != "wrist_roll")


def test_stream_of_targets_and_poses_moves_tip(arm):
    here = arm.where()
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = here.orientation, here.tip_m + np.array([0.0, 0.0, 0.01])
    with arm.stream(rate_hz=50) as stream:
        for _ in range(15):
            stream.send(T)
        for _ in range(25):
            stream.send(ikservo.Target(here.tip_m + np.array([0.0, 0.015, 0.01])))
    wanted_m = here.tip_m + np.array([0.0, 0.015, 0.01])
    np.testing.assert_allclose(true_tip_m(arm), wanted_m, atol=4e-3)


def test_stream_follows_setpoint_jump_within_arm_limits(arm):
    auditor = Auditor(arm)
    with arm.stream(speed="fast", rate_hz=50) as stream:
        for pan in [0.0] * 5 + [0.8] * 40:
            stream.send({"shoulder_pan": pan})
    assert auditor.faults() == []
    assert true_joints(arm)["shoulder_pan"] > 0.5


@pytest.mark.full
def test_stream_setpoint_outside_limits_is_clipped(arm):
    with arm.stream(rate_hz=20) as stream:
        for _ in range(40):
            stream.send({"gripper": 99.0})
    assert true_joints(arm)["gripper"] == pytest.approx(arm.where()["gripper"].upper_rad, abs=0.05)


def test_stream_refuses_and_counts_colliding_target(arm):
    with arm.stream(rate_hz=20) as stream:
        for _ in range(5):
            stream.send(ikservo.Target((0.25, 0.0, -0.08)))
        assert stream.refused >= 1  # known while it goes on
    assert "the table" in stream.reason
    assert true_tip_m(arm)[2] > 0.0


@pytest.mark.full
def test_silent_stream_holds_and_resumes_with_next_setpoint(arm):
    clock = clock_of(arm)
    with arm.stream(rate_hz=20) as stream:
        stream.send({"shoulder_pan": 1.2})
        deadline = time.monotonic() + 20.0
        while servo_group(arm).torque.is_moving and time.monotonic() < deadline:
            time.sleep(0.01)  # the program is busy with something else
        held = true_joints(arm)["shoulder_pan"]
        assert 0.0 < held < 0.6
        at_s = clock.now_s()
        stream.send({"shoulder_pan": 0.0})
        assert clock.now_s() > at_s
        for _ in range(30):
            stream.send({"shoulder_pan": 0.0})
    assert abs(true_joints(arm)["shoulder_pan"]) < 0.03
    assert all(registers(arm, "torque_enable").values())


def test_stream_send_without_rate_returns_at_once(arm):
    clock, begun_s = clock_of(arm), time.monotonic()
    with arm.stream() as stream:
        stream.send({"wrist_roll": 0.1})
        assert time.monotonic() - begun_s < 5.0
        at_s, wall_s = clock.now_s(), time.monotonic()
        while time.monotonic() - wall_s < 0.25:
            stream.send({"wrist_roll": 0.1})
            time.sleep(0.02)
        assert clock.now_s() - at_s < 2.0


def test_stream_progress_reports_last_control_cycle(arm):
    with arm.stream(rate_hz=50) as stream:
        for _ in range(10):
            stream.send({"wrist_roll": 0.1})
        assert stream.progress.names == stream.names
        assert stream.progress.joints_rad.shape == (6,)
    assert "10 sent" in repr(stream)


@pytest.mark.parametrize(
    "setpoint",
    [(0.2, 0.0, 0.1), "home", {"pan": 0.1}, {"shoulder_pan": math.nan}, np.full(6, np.inf), None,
     {"shoulder_pan": "0.1"}, np.eye(3), [0.1, [0.2]]],
)  # fmt: skip
def test_stream_send_refuses_invalid_setpoint(arm, setpoint):
    with arm.stream(rate_hz=50) as stream, pytest.raises(ikservo.InputError):
        stream.send(setpoint)


def test_stream_copies_setpoint_array_when_sent(arm):
    q = joints_of(arm)
    with arm.stream(rate_hz=50) as stream:
        for _ in range(5):
            stream.send(q)
            q[:] = 9.0
            q = joints_of_last(stream)
    assert abs(true_joints(arm)["shoulder_pan"]) < 0.05


def joints_of_last(stream):
    return stream.progress.joints_rad.copy()


def send_for_ever(stream):
    for i in itertools.count():
        stream.send({"shoulder_pan": 0.4 * math.sin(0.05 * i)})
        if i > 2000:
            raise AssertionError("nothing ended it")


def test_next_stream_send_after_stop_raises_stopped_error(arm):
    line_of(arm).world.schedule(
        line_of(arm).world.time_s + 0.5, lambda: arm.stop("the door was opened")
    )
    with pytest.raises(ikservo.StoppedError, match="door"), arm.stream(rate_hz=50) as stream:
        send_for_ever(stream)
    assert all(registers(arm, "torque_enable").values())


def test_next_stream_send_after_servo_fault_raises_error(arm):
    servo = line_of(arm).servos[servo_id("so101", "shoulder_pan")]

    def jam():
        servo.motor.stuck = True

    line_of(arm).world.schedule(line_of(arm).world.time_s + 0.5, jam)
    with (
        pytest.raises(ikservo.RefusedError, match="shoulder_pan does not follow"),
        arm.stream(rate_hz=50) as stream,
    ):
        send_for_ever(stream)


def test_error_in_stream_block_brakes_arm_and_is_raised(arm):
    def send_and_stumble():
        with arm.stream(rate_hz=50) as stream:
            for _ in range(10):
                stream.send({"shoulder_pan": 1.0})
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        send_and_stumble()
    assert arm.stopped_for == ""
    assert true_joints(arm)["shoulder_pan"] < 0.5
    assert arm.move_joints({"shoulder_pan": 0.0}).reached


@pytest.mark.full
def test_open_stream_refuses_motions_but_allows_reading_state(arm):
    with arm.stream(rate_hz=50) as stream:
        stream.send({"wrist_roll": 0.1})
        assert arm.where()["wrist_roll"].position_rad < 0.2
        for move in (
            lambda: arm.move_joints({"wrist_roll": 0.0}),
            lambda: arm.move_joints({"wrist_roll": 0.0}, wait=False),
            lambda: arm.stream().__enter__(),
        ):
            with pytest.raises(ikservo.RefusedError, match="stream of setpoints is open"):
                move()
    assert arm.move_joints({"wrist_roll": 0.0}).reached


def test_stream_without_setpoints_moves_nothing(arm):
    goals = registers(arm, "goal_position")
    with arm.stream(rate_hz=50):
        pass
    assert registers(arm, "goal_position") == goals


def test_stream_refuses_setpoints_outside_with_block(arm):
    stream = arm.stream(rate_hz=50)
    with pytest.raises(ikservo.RefusedError, match="not open"):
        stream.send({"wrist_roll": 0.1})
    with stream:
        pass
    with pytest.raises(ikservo.RefusedError, match="closed"):
        stream.send({"wrist_roll": 0.1})
    with pytest.raises(ikservo.RefusedError, match="already been used"), stream:
        pass


def test_closing_the_arm_ends_its_stream(arm):
    with arm.stream(rate_hz=50) as stream:
        stream.send({"wrist_roll": 0.1})
        arm.close()
        with pytest.raises(ikservo.StoppedError, match="Cancelled"):
            send_for_ever(stream)


@pytest.mark.sample(2)
@pytest.mark.parametrize("rate", [0.0, 2.0, -50, math.nan, 1e6, "often"])
def test_stream_refuses_invalid_rate(arm, rate):
    with pytest.raises(ikservo.BadValueError, match="rate"):
        arm.stream(rate_hz=rate)


def test_uncalibrated_arm_refuses_stream(arm, monkeypatch):
    context = replace(context_of(arm), zeros=ikservo.arm.ZeroSource.UNKNOWN)
    monkeypatch.setattr(arm, "_context", context)
    with pytest.raises(ikservo.CalibrationError):
        arm.stream()


class StandingClock:
    """A clock that only the test advances."""

    def __init__(self):
        self.at_s = 0.0

    def now_s(self):
        return self.at_s

    def sleep_until(self, deadline_s):
        self.at_s = max(self.at_s, deadline_s)


def test_stream_setpoint_replaces_older_unused_one():
    mailbox = SetpointMailbox(StandingClock(), None, lambda: False)
    mailbox.put({"a": 1.0})
    mailbox.put({"a": 2.0})
    setpoints = mailbox.setpoints()
    assert [next(setpoints), next(setpoints)] == [{"a": 2.0}, None]
