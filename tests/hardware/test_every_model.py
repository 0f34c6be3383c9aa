"""Every simulated model with every kind of adapter exchanges the same packets."""

from __future__ import annotations

import itertools

import pytest

from ikservo.errors import ServoSilentError
from ikservo.hardware import read_eeprom, torque_off, torque_on, update_eeprom
from ikservo.hardware.ping_sweep import framing_of
from ikservo.hardware.scan import identify
from ikservo.registers import MODELS, RegisterName

from .factories import (
    ECHO,
    FTDI,
    PLAIN,
    USB_FRAMES,
    PortMode,
    add_faults,
    make_bus,
    simulated_servos,
)

ADAPTERS = {"plain": PLAIN, "echo": ECHO, "USB frames": USB_FRAMES, "FTDI": FTDI}
ONE_OF_EACH_FAMILY = ("STS3215", "SCS0009", "XL430-W250", "AX-12A")


def pairs():
    """Yield every adapter with one model of each family, and every model with one adapter."""
    for model, adapter in itertools.product(MODELS, ADAPTERS):
        few = adapter == "plain" or model in ONE_OF_EACH_FAMILY
        marks = () if few else pytest.mark.campaign
        yield pytest.param((model, adapter), id=f"{model}-{adapter}", marks=marks)


@pytest.fixture(params=pairs())
def pair(request):
    return request.param


@pytest.fixture
def model(pair):
    return pair[0]


@pytest.fixture
def bus(pair):
    """Return a bus with two servos of a model behind an adapter."""
    model, adapter = pair
    bus = make_bus({1: model, 7: model}, adapter=ADAPTERS[adapter])
    bus.port.reply_timeout.min_s = bus.port.reply_timeout.max_s = 0.005  # USB takes its time
    return bus


def witness(bus, servo_id, role):
    return simulated_servos(bus)[servo_id].read(bus.servos[servo_id].table.find(role).name)


def test_ping_returns_model_of_every_servo(bus, model):
    assert {bus.ping(i).model_number for i in (1, 7)} == {MODELS[model].number}


def test_identify_finds_model_through_every_adapter(bus, pair):
    model, adapter = pair
    echoes = adapter == "echo" or PortMode.name == "echo"
    found = identify(bus.port, framing_of(MODELS[model].family), 7, echoes=echoes)
    assert found.table is MODELS[model]


def test_sync_read_positions_equal_servo_memory(bus):
    ticks = bus.sync_read([1, 7], RegisterName.PRESENT_POSITION, raw=True).require_all()
    assert ticks == {i: witness(bus, i, RegisterName.PRESENT_POSITION) for i in (1, 7)}


def test_torque_on_holds_position_and_torque_off_ends_it(bus):
    held_tick = torque_on(bus, 7)
    assert witness(bus, 7, RegisterName.GOAL_POSITION) == held_tick
    assert witness(bus, 7, RegisterName.TORQUE_ENABLE) == 1
    assert torque_off(bus, [1, 7]) == {}
    assert witness(bus, 7, RegisterName.TORQUE_ENABLE) == 0


def test_sync_write_goals_reach_servos(bus):
    goals = {i: torque_on(bus, i) + 30 for i in (1, 7)}
    bus.sync_write(RegisterName.GOAL_POSITION, goals, raw=True)
    assert bus.sync_read([1, 7], RegisterName.GOAL_POSITION, raw=True).require_all() == goals


def test_bulk_read_reads_different_registers_per_servo(bus):
    wanted = {1: [RegisterName.PRESENT_VOLTAGE], 7: [RegisterName.MODEL_NUMBER, RegisterName.ID]}
    readings = bus.bulk_read(wanted, raw=True).require_all()
    assert readings[7][RegisterName.ID] == 7
    assert readings[1][RegisterName.PRESENT_VOLTAGE] == witness(
        bus, 1, RegisterName.PRESENT_VOLTAGE
    )


def test_registered_goal_waits_for_action(bus):
    table = bus.servos[1].table
    at_tick = bus.read(1, RegisterName.GOAL_POSITION, raw=True)
    torque_on(bus, 1)
    bus.reg_write(1, table.goal_position, at_tick + 9, raw=True)
    assert bus.read(1, RegisterName.GOAL_POSITION, raw=True) == at_tick
    bus.action()
    assert bus.read(1, RegisterName.GOAL_POSITION, raw=True) == at_tick + 9


def test_eeprom_update_persists_and_is_not_written_twice(bus):
    limit = bus.servos[1].table.max_temperature_limit
    assert len(update_eeprom(bus, 1, {limit: 61})) == 1
    assert witness(bus, 1, RegisterName.MAX_TEMPERATURE_LIMIT) == 61
    assert update_eeprom(bus, 1, {limit: 61}) == []


def test_eeprom_read_equals_servo_memory(bus):
    servo = simulated_servos(bus)[1]
    copy = read_eeprom(bus, 1)
    assert copy == {name: servo.read(name) for name in copy}


def test_silent_servo_does_not_affect_values_of_others(bus):
    add_faults(bus, ("silent", {"id": 1}))
    readings = bus.sync_read([1, 7], RegisterName.PRESENT_POSITION, raw=True)
    assert readings.values.keys() == {7}
    assert isinstance(readings.errors[1], ServoSilentError)


def test_garbage_before_every_reply_is_skipped(bus):
    add_faults(bus, ("garbage", {"bytes": 5}))
    ticks = bus.sync_read([1, 7], RegisterName.PRESENT_POSITION, raw=True).require_all()
    assert ticks == {i: witness(bus, i, RegisterName.PRESENT_POSITION) for i in (1, 7)}
