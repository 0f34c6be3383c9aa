"""Packets between simulated Dynamixel arms and our driver; the servos' memory is checked."""

from __future__ import annotations

import pytest

from ikservo.errors import InputError, RegisterAccessError, ServoRejectedError, ServoSilentError
from ikservo.hardware import (
    ServoBus,
    open_port,
    read_eeprom,
    torque_off,
    torque_on,
    update_eeprom,
)
from ikservo.registers import XL330M288, XL430W250, Alarm, RegisterName

IDS = range(1, 7)


@pytest.fixture
def arm(simulated):
    """Return the bus of a simulated Koch arm, of two models, and the servos on it."""
    return simulated("koch")


def test_ping_returns_model_of_each_servo(arm):
    bus, _ = arm
    numbers = [bus.ping(servo_id).model_number for servo_id in IDS]
    assert numbers == [1060, 1060, 1200, 1200, 1200, 1200]


def test_sync_read_positions_equal_servo_memory(arm):
    bus, servos = arm
    ticks = bus.sync_read(IDS, RegisterName.PRESENT_POSITION, raw=True).require_all()
    held = {i: servo.read("present_position") for i, servo in servos.items()}
    assert ticks == pytest.approx(held, abs=5)  # limp joints sink while they are asked


def test_torque_on_sets_goal_to_position(arm):
    bus, servos = arm
    held = {servo_id: torque_on(bus, servo_id) for servo_id in IDS}
    assert {i: servo.read("goal_position") for i, servo in servos.items()} == held
    assert {servo.read("torque_enable") for servo in servos.values()} == {1}


def test_servo_moves_to_written_goal(arm):
    bus, servos = arm
    goal_tick = torque_on(bus, 1) + 100
    bus.write(1, RegisterName.GOAL_POSITION, goal_tick, raw=True)
    bus.clock.sleep_until(bus.clock.now_s() + 1.0)
    assert servos[1].read("present_position") == pytest.approx(goal_tick, abs=10)


def test_torque_off_call_switches_servo_torque_off(arm):
    bus, servos = arm
    torque_on(bus, 1)
    assert torque_off(bus, IDS) == {}
    assert servos[1].read("torque_enable") == 0


def test_voltage_of_two_servo_models_is_read_in_one_call(arm):
    bus, servos = arm
    volts = bus.sync_read(IDS, RegisterName.PRESENT_VOLTAGE).require_all()
    expected = {i: servo.read("present_input_voltage") / 10 for i, servo in servos.items()}
    assert volts == pytest.approx(expected)


def test_servo_rejects_goal_outside_its_limits(arm):
    bus, _ = arm
    torque_on(bus, 1)
    with pytest.raises(ServoRejectedError, match=r"waist|shoulder_pan.*out of range"):
        bus.write(1, RegisterName.GOAL_POSITION, 100_000, raw=True)


def test_eeprom_write_under_torque_is_refused_by_bus(arm):
    bus, _ = arm
    torque_on(bus, 1)
    with pytest.raises(RegisterAccessError, match="torque is on"):
        bus.write(1, XL430W250.drive_mode, 0)


def test_servo_rejects_eeprom_write_under_torque_unknown_to_bus(arm):
    bus, _ = arm
    torque_on(bus, 1)
    newcomer = ServoBus(bus.port, list(bus.servos.values()))
    with pytest.raises(ServoRejectedError, match="denies access"):
        newcomer.write(1, XL430W250.drive_mode, 0)


def test_eeprom_limit_persists_and_is_not_written_twice(arm):
    bus, servos = arm
    wanted = {XL330M288.velocity_limit: 300}
    assert len(update_eeprom(bus, 4, wanted)) == 1
    assert servos[4].read("velocity_limit") == 300
    assert update_eeprom(bus, 4, wanted) == []


def test_eeprom_read_contains_every_eeprom_register(arm):
    bus, servos = arm
    backup = read_eeprom(bus, 4)
    assert backup == {name: servos[4].read(name) for name in backup}
    assert {"id", "homing_offset", "current_limit"} <= set(backup)


def test_reboot_switches_torque_off(arm):
    bus, servos = arm
    torque_on(bus, 5)
    bus.reboot(5)
    assert servos[5].read("torque_enable") == 0


def test_overheated_servo_reports_heat_alarm(arm):
    bus, servos = arm
    servos[5].write("temperature_limit", 10)
    bus.clock.sleep_until(bus.clock.now_s() + 1.0)
    readings = bus.sync_read(IDS, RegisterName.PRESENT_POSITION, raw=True)
    assert readings.alarms == {5: {Alarm.UNKNOWN}}
    assert bus.read_alarms(5) == {Alarm.HEAT}
    assert bus.sync_read(IDS, RegisterName.ALARMS, raw=True).alarms == {5: {Alarm.HEAT}}


def test_silent_servo_does_not_affect_replies_of_others(arm):
    bus, servos = arm
    servos[3].write("baud_rate", 1)
    readings = bus.sync_read(IDS, RegisterName.PRESENT_POSITION, raw=True)
    assert sorted(readings.values) == [1, 2, 4, 5, 6]
    assert isinstance(readings.errors[3], ServoSilentError)


def test_second_servo_of_joint_follows_first_and_has_own_id(simulated):
    bus, servos = simulated("vx300s")
    for servo_id in (3, 2):
        torque_on(bus, servo_id)
    goal_tick = bus.read(2, RegisterName.GOAL_POSITION, raw=True) + 20
    bus.write(2, RegisterName.GOAL_POSITION, goal_tick, raw=True)
    assert servos[3].read("goal_position") == goal_tick
    assert bus.read(3, RegisterName.GOAL_POSITION, raw=True) == goal_tick


def test_missing_arm_file_of_sim_port_is_reported():
    with pytest.raises(InputError, match=r"nowhere/arm\.toml"):
        open_port("sim:/nowhere/arm.toml", 1_000_000)
