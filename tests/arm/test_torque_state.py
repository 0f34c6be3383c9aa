"""The torque state of an arm: one transition per reason, as a table and on simulated servos."""

import pytest

import ikservo
from ikservo.control.loop import ControlLoop
from ikservo.control.torque_state import TorqueState, TorqueStateMachine
from ikservo.errors import (
    BusError,
    IkservoError,
    RefusedError,
    ServoAlarmError,
    StoppedError,
)
from ikservo.motion import JointMove, KinematicLimits
from servosim.faults import Fault
from tests.arm.simulated import line_of, motion_runner, registers, servo_group

UNKNOWN, OFF, FIRST_MOTION, HOLDING, MOVING, LOWERING = TorqueState


def machine(*reasons):
    """Return a state machine after some transitions; ``limp`` and ``on`` follow from enabling."""
    torque = TorqueStateMachine()
    for reason in reasons:
        if reason in ("limp", "on"):
            torque.enabling(was_on=reason == "on")
            torque.enabled()
        else:
            getattr(torque, reason)()
    return torque


@pytest.mark.parametrize(
    ("reasons", "state", "due"),
    [
        ((), UNKNOWN, False),
        # Enabling: what was limp before moves slowly first.
        (("limp",), FIRST_MOTION, True),
        (("on",), HOLDING, False),
        (("limp", "on"), FIRST_MOTION, True),
        (("on", "limp"), FIRST_MOTION, True),
        # Control loops: several make one motion.
        (("limp", "loop_started"), MOVING, True),
        (("limp", "loop_started", "loop_ended"), FIRST_MOTION, True),
        (("limp", "loop_started", "loop_ended", "loop_started"), MOVING, True),
        (("limp", "loop_started", "loop_ended", "motion_completed"), HOLDING, False),
        (("on", "loop_started", "loop_ended", "motion_completed"), HOLDING, False),
        # Faults: what the servos do is read before the next motion, and a first one stays due.
        (("on", "faulted"), UNKNOWN, False),
        (("limp", "faulted"), UNKNOWN, True),
        (("limp", "loop_started", "faulted", "loop_ended"), UNKNOWN, True),
        (("limp", "loop_started", "faulted", "loop_ended", "on"), FIRST_MOTION, True),
        (("on", "loop_started", "faulted", "loop_ended", "on"), HOLDING, False),
        (("limp", "faulted", "motion_completed"), UNKNOWN, True),
        # Acknowledge, reconnect, relax.
        (("on", "acknowledged"), UNKNOWN, False),
        (("limp", "acknowledged"), UNKNOWN, True),
        (("on", "reconnected"), UNKNOWN, True),
        (("on", "reconnected", "on"), FIRST_MOTION, True),
        (("on", "invalidated"), UNKNOWN, False),
        (("on", "invalidated", "on"), HOLDING, False),
        # Release: of a servo that does not answer nothing is known.
        (("on", "releasing"), UNKNOWN, False),
        (("on", "releasing", "released"), OFF, True),
        (("on", "releasing", "released", "on"), FIRST_MOTION, True),
        (("on", "releasing", "released", "acknowledged"), UNKNOWN, True),
        (("on", "loop_started", "releasing", "released"), MOVING, True),
        (("on", "loop_started", "released", "faulted", "loop_ended"), OFF, True),
        # Lowering of an overheated arm: its own faults do not end it.
        (("on", "lowering_started"), LOWERING, False),
        (("on", "lowering_started", "loop_started"), MOVING, False),
        (("on", "lowering_started", "loop_started", "loop_ended"), LOWERING, False),
        (("on", "lowering_started", "loop_started", "faulted", "loop_ended"), LOWERING, False),
        (("on", "lowering_started", "motion_completed"), LOWERING, False),
        (("on", "lowering_started", "released", "lowering_ended"), OFF, True),
        (("on", "lowering_started", "faulted", "lowering_ended"), UNKNOWN, False),
        (("on", "lowering_ended"), HOLDING, False),
    ],
)
def test_events_lead_to_expected_torque_state(reasons, state, due):
    torque = machine(*reasons)
    assert (torque.state, torque.first_motion_due) == (state, due)


@pytest.mark.parametrize(
    ("reasons", "is_on", "is_moving"),
    [
        ((), False, False),
        (("released",), False, False),
        (("limp",), True, False),
        (("on",), True, False),
        (("on", "loop_started"), True, True),
        (("on", "lowering_started"), True, False),
        (("on", "loop_started", "releasing"), False, True),
    ],
)
def test_torque_state_tells_if_torque_is_on_and_arm_moves(reasons, is_on, is_moving):
    torque = machine(*reasons)
    assert (torque.is_on, torque.is_moving) == (is_on, is_moving)


@pytest.mark.parametrize("reasons", [(), ("released",), ("on", "faulted"), ("on", "acknowledged")])
@pytest.mark.parametrize("transition", ["loop_started", "lowering_started"])
def test_torque_state_refuses_motion_without_torque(reasons, transition):
    torque = machine(*reasons)
    with pytest.raises(RefusedError, match="Torque is not on"):
        getattr(torque, transition)()
    assert torque.state is machine(*reasons).state


def test_torque_state_refuses_a_second_control_loop():
    torque = machine("on", "loop_started")
    for call in (torque.check_idle, torque.loop_started):
        with pytest.raises(RefusedError, match="is moving"):
            call()
    torque.loop_ended()
    torque.check_idle()


# --- on simulated servos


@pytest.fixture
def arm():
    with ikservo.open_arm("so101", port="sim:?pose=home", collisions=False) as opened:
        yield opened


def state(arm):
    return servo_group(arm).torque.state


def test_motion_passes_expected_torque_states_in_order(arm):
    seen = [state(arm)]
    arm.enable()
    seen.append(state(arm))
    arm.move_joints({"shoulder_pan": 0.1}, on_progress=lambda _: seen.append(state(arm)))
    seen.append(state(arm))
    arm.disable_torque()
    seen.append(state(arm))
    assert list(dict.fromkeys(seen)) == [UNKNOWN, FIRST_MOTION, MOVING, HOLDING, OFF]


def test_motion_after_stopped_first_motion_is_slow(arm):
    with pytest.raises(StoppedError):
        arm.move_joints({"shoulder_pan": 0.8}, on_progress=lambda _: arm.stop("enough"))
    assert state(arm) is UNKNOWN
    arm.acknowledge()
    assert arm.plan_joints({"shoulder_pan": 0.3}, speed="fast").speed_reduced
    arm.move_joints({"shoulder_pan": 0.3})
    assert not arm.plan_joints({"shoulder_pan": 0.0}, speed="fast").speed_reduced


@pytest.mark.full
def test_motion_after_stopped_later_motion_may_be_fast(arm):
    arm.move_joints({"shoulder_pan": 0.1})
    with pytest.raises(StoppedError):
        arm.move_joints({"shoulder_pan": 0.8}, on_progress=lambda _: arm.stop("enough"))
    arm.acknowledge()
    assert state(arm) is UNKNOWN
    assert not arm.plan_joints({"shoulder_pan": 0.3}, speed="fast").speed_reduced


def test_torque_state_is_unknown_after_failed_torque_off(arm):
    arm.move_joints({"shoulder_pan": 0.1})
    line = line_of(arm)
    line.faults.add(Fault(kind="silent", id=6, at_s=line.world.time_s, for_s=0.6))
    with pytest.raises(BusError):
        arm.disable_torque()
    assert state(arm) is UNKNOWN


@pytest.mark.full
def test_torque_state_is_unknown_after_failed_torque_on(arm, monkeypatch):
    arm.move_joints({"shoulder_pan": 0.1})

    def refused(*_):
        raise RefusedError("A joint is far outside its range.")

    monkeypatch.setattr("ikservo.control.servo_group.check_supply_voltage", refused)
    with pytest.raises(RefusedError):
        arm.enable()
    assert state(arm) is UNKNOWN


def test_second_control_loop_is_refused_and_first_continues(arm):
    arm.move_joints({"shoulder_pan": 0.0})
    start, refused = servo_group(arm).goals(), []
    goal = start.copy()
    goal[0] += 0.2
    course = JointMove(start, goal, [KinematicLimits(1.0, 3.0, 30.0)] * len(start))

    def start_another(_):
        try:
            ControlLoop(servo_group(arm)).run(course)
        except RefusedError as error:
            refused.append(error.message)

    measured = ControlLoop(servo_group(arm)).run(course, start_another)
    assert set(refused) == {"The arm is moving."}
    assert arm.stop_reason is None
    assert measured[0] == pytest.approx(goal[0], abs=0.1)


@pytest.mark.full
def test_acknowledge_without_stop_keeps_state_moving(arm):
    seen = []

    def acknowledge(_):
        arm.acknowledge()
        seen.append(state(arm))

    arm.move_joints({"shoulder_pan": 0.2}, on_progress=acknowledge)
    assert set(seen) == {MOVING}
    assert state(arm) is HOLDING


@pytest.mark.full
def test_overheated_arm_is_lowered_only_once_even_on_failure(arm, monkeypatch):
    arm.move_joints({"shoulder_pan": 0.1})
    started, hot = [], ServoAlarmError("elbow_flex is too hot", "Let it cool down.")

    def overheat(_):
        raise hot

    def lower(*_):
        started.append(state(arm))
        arm.move_joints({"shoulder_pan": 0.0}, on_progress=overheat)

    monkeypatch.setattr(type(servo_group(arm)), "overheated", True)
    monkeypatch.setattr(motion_runner(arm), "on_overheat", lower)
    with pytest.raises(IkservoError, match="too hot"):
        arm.move_joints({"shoulder_pan": 0.3}, on_progress=overheat)
    assert started == [LOWERING]
    assert state(arm) is UNKNOWN
    assert "too hot" in arm.stopped_for


@pytest.mark.parametrize("name", ["so101", "wx250s"])
def test_torque_of_one_joint_can_be_enabled_in_limp_arm(name):
    with ikservo.open_arm(name, "sim") as arm:
        for joint in servo_group(arm).names:
            motion_runner(arm).set_joint_torque(joint, on=True)
        assert set(registers(arm, "torque_enable").values()) == {1}
