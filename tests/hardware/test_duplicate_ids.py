"""Two servos with one id are detected before anything else, without false alarms."""

from __future__ import annotations

import random
import sys

import pytest

import ikservo
from ikservo.errors import BadReplyError
from ikservo.hardware import Port, ServoBus, ServoSpec
from ikservo.hardware.duplicate_ids import find_duplicate_ids, raise_on_duplicate_ids
from ikservo.hardware.ping_sweep import framing_of
from ikservo.hardware.scan import identify
from ikservo.registers import control_table
from tests.cli.fixtures_ports import change_bus

from .campaign import DYNAMIXEL, EVERYTHING, FEETECH
from .factories import BAUD, ECHO, FTDI, PortMode, add_faults, make_bus, make_transport

FAMILIES = [
    ("STS3215", "STS3250"),
    ("XL430-W250", "XL330-M288", "XM430-W350"),
    ("AX-12A", "MX-28"),
    ("SCS0009", "SCS15"),
]
DELAYS = (0, 0, 1, 10, 50, 250)  # raw; the same ones let two servos speak at once
both = pytest.mark.parametrize("models", [FEETECH, DYNAMIXEL], ids=["Feetech", "Dynamixel"])


def crowded_bus(seed):
    """Return a random bus on which two servos share an id, and that id."""
    chance = random.Random(seed)
    family = FAMILIES[seed % len(FAMILIES)]
    models = {i: chance.choice(family) for i in range(1, chance.randrange(2, 7))}
    twin = chance.choice([*models])
    alike = chance.random() < 0.5
    second = models[twin] if alike else chance.choice(family)
    transport = make_transport([*models.items(), (twin, second)], BAUD, seed)
    for servo in transport.line.world.servos:
        if servo.id == twin:
            _make_own(servo, chance, alike=alike)
    servos = [ServoSpec(i, control_table(model), f"joint_{i}") for i, model in models.items()]
    return ServoBus(Port(transport, "bench", BAUD), servos), twin


def _make_own(servo, chance, *, alike):
    names = servo.table.by_name
    delay = "return_delay" if "return_delay" in names else "return_delay_time"
    if delay in names:
        servo.memory.put(delay, chance.choice(DELAYS))
    for name in () if alike else ("max_temperature_limit", "temperature_limit", "max_torque"):
        if name in names:
            servo.memory.put(name, chance.randrange(20, 80))


def eeprom_writes(bus):
    return sum(servo.memory.eeprom_writes for servo in bus.port.transport.line.world.servos)


@pytest.mark.parametrize(
    "buses", [pytest.param(24, id="suite"), pytest.param(400, marks=pytest.mark.campaign)]
)
@pytest.mark.timeout(600)
def test_duplicate_ids_are_found_on_random_buses_without_writes(buses, capsys):
    for seed in range(buses):
        bus, twin = crowded_bus(seed)
        before = eeprom_writes(bus)
        assert [servo.id for servo in find_duplicate_ids(bus)] == [twin], seed
        assert eeprom_writes(bus) == before
    with capsys.disabled():
        sys.stdout.write(f"\nB4: {buses} buses with a shared id, 0 missed\n" * (buses > 100))


def test_duplicate_id_error_names_joint_and_setup_command():
    bus, twin = crowded_bus(3)
    with pytest.raises(BadReplyError, match=rf"joint_{twin} \(id {twin}\).*\n.*ikservo setup ARM"):
        raise_on_duplicate_ids(bus)


@pytest.mark.usefixtures("plain_line")
@both
@pytest.mark.parametrize("adapter", [None, ECHO, FTDI], ids=["plain", "echo", "FTDI"])
@pytest.mark.parametrize("seed", range(5))
def test_bus_faults_are_not_reported_as_duplicate_ids(models, adapter, seed):
    bus = make_bus(models, seed=seed, adapter=adapter)
    add_faults(bus, *EVERYTHING)
    assert find_duplicate_ids(bus) == []


def test_bus_echo_is_not_reported_as_duplicate_id():
    assert find_duplicate_ids(make_bus({1: "STS3215"}, adapter=ECHO)) == []


@pytest.mark.parametrize("model", ["AX-12A", "MX-28", "SCS0009", "STS3215", "XM430-W350"])
def test_identify_finds_model_of_every_family(model):
    bus = make_bus({1: model})
    table = bus.servos[1].table
    found = identify(bus.port, framing_of(table.family), 1, echoes=PortMode.name == "echo")
    assert (found.table, found.temperature_c) == (table, 25.0)


@both
def test_silent_servo_is_not_reported_as_duplicate_id(models):
    bus = make_bus(models)
    add_faults(bus, ("silent", {"id": 3}))
    assert find_duplicate_ids(bus) == []


@pytest.mark.parametrize("arm", ["so101", "koch"])
def test_open_arm_refuses_duplicate_ids(monkeypatch, arm):
    change_bus(monkeypatch, lambda line: line.servos[3].memory.put("id", 2))
    with pytest.raises(BadReplyError, match=r"\(id 2\) on .* answers as if it were several servos"):
        ikservo.open_arm(arm, port="sim")
