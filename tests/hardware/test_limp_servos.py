"""No goal reaches a limp servo, whose torque it would switch on, unless that is intended."""

from __future__ import annotations

import pytest

from ikservo.errors import RefusedError, RegisterAccessError, ServoSilentError
from ikservo.hardware import torque_on
from ikservo.registers import STS3215, RegisterName

from .factories import add_faults, make_bus, simulated_servos

GOAL, TORQUE = RegisterName.GOAL_POSITION, RegisterName.TORQUE_ENABLE
MODELS = ("STS3215", "SCS0009", "XL430-W250", "AX-12A")
WRITES = {
    "write": lambda bus, tick: bus.write(1, GOAL, tick, raw=True),
    "reg_write": lambda bus, tick: bus.reg_write(1, GOAL, tick, raw=True),
    "sync_write": lambda bus, tick: bus.sync_write(GOAL, {2: tick, 1: tick}, raw=True),
    "bulk_write": lambda bus, tick: bus.bulk_write(
        {1: {RegisterName.PROFILE_VELOCITY: 100, GOAL: tick}}, raw=True
    ),
    "in radians": lambda bus, _: bus.write(1, GOAL, 3.0),
}


def limp_bus(model):
    """Return a bus with two servos, the second with torque, and the position of the first."""
    bus = make_bus({1: model, 2: model})
    torque_on(bus, 2)
    return bus, simulated_servos(bus)[1].read("present_position")


def holds(bus, servo_id=1):
    servo = simulated_servos(bus)[servo_id]
    return servo.drive.torque_on or servo.read("torque_enable") != 0


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("write", WRITES.values(), ids=WRITES)
def test_goal_write_with_torque_off_is_refused(model, write):
    bus, at_tick = limp_bus(model)
    goals = [servo.read("goal_position") for servo in simulated_servos(bus).values()]
    with pytest.raises(RegisterAccessError, match="torque is off, and a goal can switch it on"):
        write(bus, at_tick + 20)
    bus.ping(2)  # what was sent has arrived
    assert [s.read("goal_position") for s in simulated_servos(bus).values()] == goals
    assert not holds(bus)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("by_this_bus", [True, False])
def test_prepared_goal_packet_is_refused_after_torque_off(model, by_this_bus):
    bus, at_tick = limp_bus(model)
    torque_on(bus, 1)
    bus.reg_write(1, GOAL, at_tick + 20, raw=True)
    if by_this_bus:
        bus.write(1, TORQUE, 0, raw=True)
    else:
        simulated_servos(bus)[1].write("torque_enable", 0)
    with pytest.raises(RegisterAccessError, match="torque is off, and a goal can switch it on"):
        bus.action()
    bus.ping(1)
    assert not holds(bus)
    assert simulated_servos(bus)[1].read("goal_position") != at_tick + 20


def test_prepared_goal_packet_is_sent_while_torque_is_on():
    bus, at_tick = limp_bus("STS3215")
    torque_on(bus, 1)
    bus.reg_write(1, GOAL, at_tick + 20, raw=True)
    bus.action()
    bus.ping(1)
    assert simulated_servos(bus)[1].read("goal_position") == at_tick + 20
    bus.write(1, TORQUE, 0, raw=True)
    bus.action()  # nothing is prepared any more


@pytest.mark.parametrize("model", MODELS)
def test_torque_switched_on_by_another_program_is_detected(model):
    bus, at_tick = limp_bus(model)
    simulated_servos(bus)[1].write("torque_enable", 1)
    bus.write(1, GOAL, at_tick + 5, raw=True)
    assert simulated_servos(bus)[1].read("goal_position") == at_tick + 5


def test_torque_switched_off_by_this_bus_is_remembered():
    bus, _ = limp_bus("STS3215")
    bus.write(2, TORQUE, 0, raw=True)
    assert not bus.is_torque_on(2)
    with pytest.raises(RegisterAccessError, match="torque is off"):
        bus.write(2, GOAL, 2048, raw=True)


def test_torque_on_refuses_goal_far_from_measured_position():
    bus, at_tick = limp_bus("STS3215")
    with (
        pytest.raises(RegisterAccessError, match="far from"),
        bus.enabling({1: at_tick}),
    ):
        bus.write(1, GOAL, at_tick + 300, raw=True)
    assert not holds(bus)


def test_torque_switched_on_by_goal_goes_off_if_enabling_fails():
    bus, at_tick = limp_bus("STS3215")

    def fail():
        with bus.enabling({1: at_tick, 2: 2048}):
            bus.write(1, GOAL, at_tick, raw=True)
            assert holds(bus)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail()
    assert (holds(bus, 1), holds(bus, 2)) == (False, True)


def test_servo_with_torque_on_still_holds_if_goal_write_fails():
    bus, at_tick = limp_bus("STS3215")
    servo = simulated_servos(bus)[1]
    servo.write("torque_enable", 1)
    servo.on_write = lambda *_: add_faults(bus, ("silent", {"id": 1, "for_s": 0.05}))
    with pytest.raises(ServoSilentError):
        torque_on(bus, 1)
    servo.on_write = None
    assert (holds(bus), servo.read("goal_position")) == (True, at_tick)


def test_torque_off_write_without_reply_counts_as_off():
    bus, _ = limp_bus("STS3215")
    simulated_servos(bus)[2].on_write = lambda *_: add_faults(bus, ("silent", {"id": 2}))
    with pytest.raises(ServoSilentError):
        bus.write(2, TORQUE, 0, raw=True)
    assert not bus.is_torque_on(2)


def test_servo_torque_goes_off_if_enabling_is_incomplete():
    bus, at_tick = limp_bus("STS3215")
    with bus.enabling({1: at_tick}):
        bus.write(1, GOAL, at_tick, raw=True)
    assert not holds(bus)


def test_silent_servo_during_torque_on_leaves_torque_off():
    bus, _ = limp_bus("STS3215")
    add_faults(bus, ("silent", {"id": 1, "at_s": bus.clock.now_s() + 0.002, "for_s": 0.05}))
    with pytest.raises(ServoSilentError):
        torque_on(bus, 1)
    bus.clock.sleep_until(bus.clock.now_s() + 0.1)
    assert not holds(bus)


@pytest.mark.parametrize("mode", [1, 2, 3])
def test_torque_on_refuses_other_operating_mode(mode):
    bus, _ = limp_bus("STS3215")
    simulated_servos(bus)[1].write("operating_mode", mode)
    with pytest.raises(RefusedError, match=f"its operating mode is {mode}"):
        torque_on(bus, 1)
    assert not holds(bus)


@pytest.mark.parametrize("model", ["SCS0009", "AX-12A"])
def test_torque_on_refuses_continuous_rotation(model):
    bus, _ = limp_bus(model)
    low, high = (
        bus.servos[1].table.find(name).name
        for name in (RegisterName.MIN_POSITION_LIMIT, RegisterName.MAX_POSITION_LIMIT)
    )
    for name in (low, high):
        simulated_servos(bus)[1].write(name, 0)
    with pytest.raises(RefusedError, match="both its position limits are 0"):
        torque_on(bus, 1)
    assert not holds(bus)


@pytest.mark.parametrize(("outside", "switched_on"), [(30, True), (600, False)])
def test_torque_on_outside_limits_works_only_near_limit(outside, switched_on):
    bus, at_tick = limp_bus("STS3215")
    simulated_servos(bus)[1].write("max_position_limit", at_tick - outside)
    if switched_on:
        assert torque_on(bus, 1) == at_tick - outside
    else:
        with pytest.raises(RefusedError, match="far outside the range"):
            torque_on(bus, 1)
    assert holds(bus) == switched_on


def test_registers_other_than_goal_are_writable_with_torque_off():
    bus, _ = limp_bus("STS3215")
    bus.bulk_write({1: {STS3215.acceleration: 9, STS3215.goal_speed: 100}}, raw=True)
    bus.ping(1)
    assert simulated_servos(bus)[1].read("goal_speed") == 100
    assert not holds(bus)
