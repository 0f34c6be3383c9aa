"""Registers as delivered, compared with the simulator's copy of the data sheets."""

import pytest

from ikservo.registers import MODELS, Area
from ikservo.registers.delivered import delivered_value
from servosim.servo_models import table_for


@pytest.mark.parametrize("model", MODELS)
def test_factory_eeprom_values_equal_data_sheet(model):
    sheet = {row.address: row for row in table_for(model).registers}
    for register in MODELS[model].registers.values():
        value = delivered_value(MODELS[model], register)
        if register.is_writable and register.area is Area.EEPROM:
            assert value is not None, register
        if value is not None:
            assert value == sheet[register.address].default, register
            low, high = register.range
            assert low <= value <= high, register
