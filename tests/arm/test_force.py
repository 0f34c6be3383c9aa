"""Each servo model has one register that limits its torque, as a fraction of its maximum."""

import pytest

from ikservo.control.watchdog_and_torque_limits import (
    ServoRamLimits,
    limit_torque,
    torque_limit_registers,
)
from ikservo.errors import RegisterAccessError
from ikservo.hardware import torque_on
from ikservo.registers import MODELS, Access, Area, Family, OperatingMode, RegisterName
from tests.hardware.factories import make_bus

LIMITED = {
    name: ("goal_pwm", "pwm_limit")
    if "pwm_limit" in table.registers
    else ("torque_limit", "max_torque")
    for name, table in MODELS.items()
    if table.family is not Family.FEETECH_SCS
}
"""In position mode; the SCS models have none."""

WITH_CURRENT = [name for name, table in MODELS.items() if "goal_current" in table.registers]


def servo_register(bus, name):
    return bus.servos[1].table.registers[name]


def names_of(found):
    return tuple(register.name for register in found)


@pytest.mark.parametrize("model", MODELS)
def test_servo_model_has_expected_torque_limit_registers(model):
    bus = make_bus({1: model})
    found = torque_limit_registers(bus, 1)
    assert (names_of(found) if found else None) == LIMITED.get(model)


@pytest.mark.parametrize("model", WITH_CURRENT)
def test_goal_current_limits_torque_in_current_position_mode(model):
    bus = make_bus({1: model})
    bus.port.transport.line.servos[1].memory.put(
        "operating_mode", OperatingMode.CURRENT_BASED_POSITION
    )
    assert names_of(torque_limit_registers(bus, 1)) == ("goal_current", "current_limit")


@pytest.mark.parametrize("model", LIMITED)
def test_torque_limit_in_ram_is_fraction_of_eeprom_maximum(model):
    bus = make_bus({1: model})
    limit, most = torque_limit_registers(bus, 1)
    assert (limit.area, limit.access, most.area) == (Area.RAM, Access.RW, Area.EEPROM)
    limit_torque(bus, 1, 0.25)
    top = bus.read(1, most, raw=True)
    assert bus.read(1, limit, raw=True) == round(0.25 * top) > 0


@pytest.mark.parametrize("model", sorted(MODELS.keys() - LIMITED.keys()))
def test_servo_without_torque_limit_register_refuses_force(model):
    with pytest.raises(RegisterAccessError, match="this servo has none in RAM"):
        limit_torque(make_bus({1: model}), 1, 0.5)


def test_hls_servo_with_zero_goal_torque_moves_after_torque_on():
    bus = make_bus({1: "HLS3606M"})
    servo = bus.port.transport.line.servos[1]
    bus.write(1, servo_register(bus, "goal_torque"), 0, raw=True)
    goal_tick = torque_on(bus, 1) + 200
    moved_ticks = []
    for _ in range(2):
        bus.write(1, RegisterName.GOAL_POSITION, goal_tick, raw=True)
        bus.clock.sleep_until(bus.clock.now_s() + 0.5)
        moved_ticks.append(bus.read(1, RegisterName.PRESENT_POSITION, raw=True) - goal_tick + 200)
        ServoRamLimits(bus, [1]).prepare(1)
    assert moved_ticks == pytest.approx([0, 200], abs=8)
    assert servo.read("goal_torque") == servo.read("protection_current")


@pytest.mark.parametrize("speed_rad_s", [0.05, 0.1, 0.5, 3.0])
def test_hls_servo_profile_speed_is_not_below_motion_speed(speed_rad_s):
    bus = make_bus({1: "HLS3606M"})
    limits = ServoRamLimits(bus, [1])
    limits.prepare(1)
    limits.set_speed(speed_rad_s)
    assert bus.read(1, RegisterName.PROFILE_VELOCITY) >= speed_rad_s


@pytest.mark.parametrize("model", LIMITED)
@pytest.mark.parametrize("yielding", [False, True])
def test_torque_limit_is_removed_before_torque_on(model, yielding):
    bus = make_bus({1: model})
    if yielding and model in WITH_CURRENT:
        memory = bus.port.transport.line.servos[1].memory
        memory.put("operating_mode", OperatingMode.CURRENT_BASED_POSITION)
    limit, most = torque_limit_registers(bus, 1)
    limit_torque(bus, 1, 0.25)
    ServoRamLimits(bus, [1]).prepare(1)
    assert bus.read(1, limit, raw=True) == bus.read(1, most, raw=True)
