"""Each servo model has one register that limits its torque, as a share of its most."""

import pytest

from ikservo.control.servo_limits import ServoRamLimits, limit_torque, torque_limit_registers
from ikservo.errors import RegisterAccessError
from ikservo.registers import MODELS, Access, Area, Family, OperatingMode
from tests.hardware.factories import make_bus

LIMITED = {
    name: ("goal_pwm", "pwm_limit")
    if "goal_pwm" in table.registers
    else ("torque_limit", "max_torque")
    for name, table in MODELS.items()
    if table.family is not Family.FEETECH_SCS
}
"""In position mode; the SCS models have none."""

WITH_CURRENT = [name for name, table in MODELS.items() if "goal_current" in table.registers]


def names_of(found):
    return tuple(register.name for register in found)


@pytest.mark.parametrize("model", MODELS)
def test_every_model_has_its_limit_or_none(model):
    bus = make_bus({1: model})
    found = torque_limit_registers(bus, 1)
    assert (names_of(found) if found else None) == LIMITED.get(model)


@pytest.mark.parametrize("model", WITH_CURRENT)
def test_in_current_based_position_mode_the_current_is_the_limit(model):
    bus = make_bus({1: model})
    bus.port.transport.line.servos[1].memory.put(
        "operating_mode", OperatingMode.CURRENT_BASED_POSITION
    )
    assert names_of(torque_limit_registers(bus, 1)) == ("goal_current", "current_limit")


@pytest.mark.parametrize("model", LIMITED)
def test_the_limit_is_written_to_ram_as_a_share_of_what_eeprom_allows(model):
    bus = make_bus({1: model})
    limit, most = torque_limit_registers(bus, 1)
    assert (limit.area, limit.access, most.area) == (Area.RAM, Access.RW, Area.EEPROM)
    limit_torque(bus, 1, 0.25)
    top = bus.read(1, most, raw=True)
    assert bus.read(1, limit, raw=True) == round(0.25 * top) > 0


@pytest.mark.parametrize("model", sorted(MODELS.keys() - LIMITED.keys()))
def test_a_model_without_a_limit_is_refused(model):
    with pytest.raises(RegisterAccessError, match="there is none in RAM"):
        limit_torque(make_bus({1: model}), 1, 0.5)


@pytest.mark.parametrize("model", LIMITED)
@pytest.mark.parametrize("yielding", [False, True])
def test_whatever_limits_the_force_is_lifted_before_torque_comes_on(model, yielding):
    bus = make_bus({1: model})
    if yielding and model in WITH_CURRENT:
        memory = bus.port.transport.line.servos[1].memory
        memory.put("operating_mode", OperatingMode.CURRENT_BASED_POSITION)
    limit, most = torque_limit_registers(bus, 1)
    limit_torque(bus, 1, 0.25)
    ServoRamLimits(bus, [1]).prepare(1)
    assert bus.read(1, limit, raw=True) == bus.read(1, most, raw=True)
