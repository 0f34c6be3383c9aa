"""Control tables of ikservo and of the simulator, copied independently, agree."""

from __future__ import annotations

import pytest

from ikservo.registers import MODELS, Access, Area
from servosim.servo_models import TABLES

OURS = pytest.mark.parametrize("table", MODELS.values(), ids=MODELS)


def test_driver_and_simulator_support_same_servo_models():
    assert set(MODELS) == set(TABLES) - {"STS3215-C018"}


def test_sts3215_c018_has_number_and_registers_of_sts3215():
    variant = TABLES["STS3215-C018"]
    assert variant.number == MODELS["STS3215"].number
    assert [row.name for row in variant.registers] == [
        row.name for row in TABLES["STS3215"].registers
    ]


@OURS
def test_servo_model_numbers_equal_those_of_simulator(table):
    assert table.number == TABLES[table.model_name].number


@OURS
def test_ticks_per_turn_equal_those_of_simulator(table):
    assert table.ticks_per_turn == pytest.approx(TABLES[table.model_name].ticks_per_turn)


@OURS
def test_register_names_addresses_and_access_equal_simulator(table):
    theirs = {
        row.name: (row.address, row.size, row.writable, row.area.name)
        for row in TABLES[table.model_name].registers
        if not row.name.startswith("indirect_")
    }
    ours = {
        register.name: (
            register.address,
            register.size,
            register.access is Access.RW,
            "EEPROM" if register.area is Area.EEPROM else "RAM",
        )
        for register in table.registers.values()
    }
    assert ours == theirs


@OURS
def test_register_encodings_equal_those_of_simulator(table):
    rows = {row.name: row for row in TABLES[table.model_name].registers}
    for name, register in table.registers.items():
        row = rows[name]
        for number in (0, 1, 255, 1000, -1, -1000):
            if (
                row.lower <= number <= row.upper
                and register.range[0] <= number <= register.range[1]
            ):
                assert register.encode(number) == row.encode(number), f"{name} = {number}"
