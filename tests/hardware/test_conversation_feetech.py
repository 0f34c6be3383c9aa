"""Packets between a simulated SO-101 and our driver; the servos' memory is checked."""

from __future__ import annotations

import pytest

from ikservo.errors import BusError, PortLostError, ServoSilentError
from ikservo.hardware import read_eeprom, torque_off, torque_on, update_eeprom
from ikservo.registers import STS3215, Alarm, RegisterName

IDS = range(1, 7)


@pytest.fixture
def arm(simulated):
    """Return the bus of a simulated SO-101 and the servos on it."""
    return simulated("so101")


def test_ping_returns_model_of_every_servo(arm):
    bus, _ = arm
    assert {bus.ping(servo_id).model_number for servo_id in IDS} == {777}


def test_sync_read_positions_equal_servo_memory(arm):
    bus, servos = arm
    ticks = bus.sync_read(IDS, RegisterName.PRESENT_POSITION, raw=True).require_all()
    assert ticks == {i: servo.read("present_position") for i, servo in servos.items()}


def test_torque_on_does_not_jump_to_old_goal(arm):
    bus, servos = arm
    wrist_roll = servos[5]  # gravity does not turn it
    wrist_roll.write("goal_position", 1000)
    wrist_roll.write("torque_enable", 0)
    before_tick = wrist_roll.read("present_position")
    torque_on(bus, 5)
    bus.clock.sleep_until(bus.clock.now_s() + 1.0)
    assert wrist_roll.read("torque_enable") == 1
    assert wrist_roll.read("present_position") == pytest.approx(before_tick, abs=2)


def test_servos_move_to_written_goals(arm):
    bus, servos = arm
    goals = {servo_id: torque_on(bus, servo_id) for servo_id in IDS}
    goals[1] += 200
    bus.sync_write(RegisterName.GOAL_POSITION, goals, raw=True)
    bus.clock.sleep_until(bus.clock.now_s() + 1.0)
    assert servos[1].read("goal_position") == goals[1]
    assert servos[1].read("present_position") == pytest.approx(goals[1], abs=10)


def test_registered_goals_start_together_on_action_instruction(arm):
    bus, servos = arm
    for servo_id in (1, 5):
        torque_on(bus, servo_id)
        bus.reg_write(servo_id, STS3215.goal_position, 2100, raw=True)
    assert servos[1].read("goal_position") != 2100
    bus.action()
    bus.read(
        6, RegisterName.PRESENT_POSITION
    )  # an action is not answered: the next answer comes behind it
    assert [servos[i].read("goal_position") for i in (1, 5)] == [2100, 2100]


def test_torque_off_reaches_others_although_one_is_silent(arm):
    bus, servos = arm
    for servo_id in IDS:
        torque_on(bus, servo_id)
    unresponsive = servos[3]
    unresponsive.write("lock", 0)
    unresponsive.write("baud_rate", 4)
    assert list(torque_off(bus, IDS)) == [3]
    assert [servo.read("torque_enable") for servo in servos.values()] == [0, 0, 1, 0, 0, 0]


def test_silent_servo_does_not_affect_replies_of_others(arm):
    bus, servos = arm
    servos[3].write("lock", 0)
    servos[3].write("baud_rate", 4)
    readings = bus.sync_read(IDS, RegisterName.PRESENT_POSITION, raw=True)
    assert sorted(readings.values) == [1, 2, 4, 5, 6]
    assert isinstance(readings.errors[3], ServoSilentError)
    assert "elbow_flex (id 3)" in str(readings.errors[3])


def test_alarm_is_reported_along_with_values(arm):
    bus, servos = arm
    servos[2].write("max_temperature_limit", 10)
    bus.clock.sleep_until(bus.clock.now_s() + 1.0)
    readings = bus.sync_read(IDS, RegisterName.PRESENT_POSITION, raw=True)
    assert readings.alarms == {2: {Alarm.HEAT}}
    assert sorted(readings.require_all()) == list(IDS)


def test_all_servos_are_silent_at_wrong_baud_rate(simulated):
    bus, _ = simulated("so101", baud_rate=115_200)
    with pytest.raises(ServoSilentError, match="all baud rates"):
        bus.sync_read(IDS, RegisterName.PRESENT_POSITION).require_all()


def test_pulled_cable_raises_port_lost_error(arm):
    bus, _ = arm
    bus.port.transport.close()
    with pytest.raises(PortLostError, match="Lost connection"):
        bus.read(1, RegisterName.PRESENT_POSITION)


def test_homing_offset_persists_and_is_not_written_twice(arm):
    bus, servos = arm
    assert len(update_eeprom(bus, 1, {STS3215.homing_offset: -100})) == 1
    assert servos[1].read("homing_offset") == -100
    assert servos[1].read("lock") == 1
    assert update_eeprom(bus, 1, {STS3215.homing_offset: -100}) == []


def test_eeprom_read_contains_every_eeprom_register(arm):
    bus, servos = arm
    backup = read_eeprom(bus, 4)
    assert backup == {name: servos[4].read(name) for name in backup}
    assert {"id", "homing_offset", "phase"} <= set(backup)


@pytest.mark.usefixtures("plain_line")
def test_six_servo_cycle_uses_over_85_percent_of_bus_bandwidth(arm):
    bus, _ = arm
    ticks = {servo_id: torque_on(bus, servo_id) for servo_id in IDS}
    started_s, cycles = bus.clock.now_s(), 50
    for _ in range(cycles):
        bus.sync_write(RegisterName.GOAL_POSITION, ticks, raw=True)
        bus.sync_read(IDS, RegisterName.PRESENT_POSITION, raw=True).require_all()
    wire_s = bus.port.wire_s((8 + 6 * 3) + (8 + 6 + 6 * 8))
    assert wire_s / ((bus.clock.now_s() - started_s) / cycles) > 0.85


def test_silent_servo_delays_cycle_by_at_most_5_ms(arm):
    bus, servos = arm
    bus.load_return_delays()
    servos[6].write("lock", 0)
    servos[6].write("baud_rate", 4)
    for _ in range(3):
        bus.sync_read(IDS, RegisterName.PRESENT_POSITION)
    started_s = bus.clock.now_s()
    bus.sync_read(IDS, RegisterName.PRESENT_POSITION)
    assert bus.clock.now_s() - started_s < 0.005


def test_reboot_of_feetech_servo_raises_bus_error(arm):
    bus, _ = arm
    with pytest.raises(BusError):
        bus.reboot(1)
