"""The XL-320: protocol 2.0 with another control table than every X servo."""

from __future__ import annotations

import pytest

from ikservo.errors import RefusedError, RegisterAccessError
from ikservo.hardware import torque_off, torque_on, update_eeprom
from ikservo.hardware.ping_sweep import framing_of
from ikservo.hardware.scan import identify
from ikservo.registers import Alarm, Family, RegisterName

from .factories import PortMode, make_bus, simulated_servos


@pytest.fixture
def bus():
    """Return a bus with an XL-320 beside an XL430."""
    return make_bus({1: "XL-320", 2: "XL430-W250", 3: "XL-320"})


def test_xl320_is_read_together_with_x_servos(bus):
    ticks = bus.sync_read([1, 2, 3], RegisterName.PRESENT_POSITION, raw=True).require_all()
    assert ticks == {i: s.read("present_position") for i, s in simulated_servos(bus).items()}


def test_torque_is_refused_for_xl320_in_wheel_mode(bus):
    update_eeprom(bus, 1, {bus.servos[1].table.operating_mode: 1})
    with pytest.raises(RefusedError, match="its operating mode is 1"):
        torque_on(bus, 1)
    assert simulated_servos(bus)[1].read("torque_enable") == 0


def test_xl320_eeprom_is_not_written_under_torque(bus):
    torque_on(bus, 1)
    limit = bus.servos[1].table.max_temperature_limit
    with pytest.raises(RegisterAccessError, match="torque"):
        update_eeprom(bus, 1, {limit: 61})
    torque_off(bus, [1])
    assert len(update_eeprom(bus, 1, {limit: 61})) == 1


def test_xl320_and_x_servo_have_different_alarm_bits(bus):
    simulated_servos(bus)[1].inject_alarm(0b100)
    found = identify(bus.port, framing_of(Family.DYNAMIXEL_2), 1, echoes=PortMode.name == "echo")
    assert found.alarms == (Alarm.VOLTAGE,)
