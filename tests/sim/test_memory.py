"""Registers that the firmware reads by name agree with the bytes in memory."""

from __future__ import annotations

import pytest

from servosim.register import Memory
from servosim.servo_models import TABLES

WAYS = {
    "an instruction's write": lambda memory: memory.write(0, b"\x5a" * memory.table.size),
    "a write of one byte": lambda memory: memory.write(memory.table.size - 1, b"\x5a"),
    "the firmware": lambda memory: [memory.put(row.name, 1) for row in memory.table.registers],
    "a loss of power": Memory.power_cycle,
    "a reset": Memory.restore_factory,
}


def decoded(memory):
    return {
        row.name: row.decode(memory.image[row.address : row.end]) for row in memory.table.registers
    }


def numbers(memory):
    return {row.name: memory.get(row.name) for row in memory.table.registers}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("model", TABLES)
def test_register_value_is_decoded_again_after_memory_change(way, model):
    memory = Memory(TABLES[model], {"id": 7})
    memory.write(0, b"\xa5" * memory.table.size)
    assert numbers(memory) == decoded(memory)
    before = bytes(memory.image)
    WAYS[way](memory)
    assert memory.image != before
    assert numbers(memory) == decoded(memory)


def test_measured_register_is_updated_before_each_access(make_port):
    port = make_port("STS3215")
    servo = port.line.servos[1]
    assert servo.read("present_voltage") == servo.memory.get("present_voltage") != 30
    servo.supply_v = 3.0
    assert servo.read("present_voltage") == servo.memory.get("present_voltage") == 30


@pytest.mark.parametrize("model", TABLES)
def test_simulated_registers_do_not_overlap(model):
    table = TABLES[model]
    assert sum(row.size for row in table.registers) == sum(row is not None for row in table.by_byte)
