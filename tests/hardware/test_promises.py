"""Promises about the bus that can be tested at this level, each with its number."""

from __future__ import annotations

import random
import sys

import pytest

from ikservo.errors import BusError, ServoRejectedError, ServoSilentError
from ikservo.hardware import torque_on, update_eeprom
from ikservo.hardware.late_replies import LineHealth
from ikservo.hardware.protocols import protocol1
from ikservo.hardware.protocols.protocol2 import Protocol2Codec
from ikservo.registers import STS3215, Alarm, RegisterName

from .factories import ECHO, PLAIN, add_faults, make_bus, simulated_servos
from .test_exchange_laws import packet_1, packet_2

X = "XL430-W250"
SIX = {"Feetech": dict.fromkeys(range(1, 7), "STS3215"), "Dynamixel": dict.fromkeys(range(1, 7), X)}
six = pytest.mark.parametrize("models", SIX.values(), ids=SIX)


def cycle(bus, goals):
    started_s = bus.clock.now_s()
    bus.sync_write(RegisterName.GOAL_POSITION, goals, raw=True)
    bus.sync_read(goals, RegisterName.PRESENT_POSITION, raw=True)
    return bus.clock.now_s() - started_s


def goals_of(bus):
    for servo in simulated_servos(bus).values():  # as `ikservo setup` leaves them
        name = "return_delay" if "return_delay" in servo.table.by_name else "return_delay_time"
        servo.write(name, 0)
    bus.load_return_delays()
    return {servo_id: torque_on(bus, servo_id) for servo_id in bus.servos}


# --- B1: a corrupted packet is never used as data ---


@pytest.mark.parametrize(
    "packets",
    [pytest.param(10_000, id="suite"), pytest.param(1_000_000, marks=pytest.mark.campaign)],
)
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("protocol", [1, 2])
def test_damaged_packet_is_refused_and_next_one_found(protocol, packets, capsys):
    make, scan = (
        (packet_1, protocol1.scan_packets)
        if protocol == 1
        else (packet_2, Protocol2Codec(-2000).scan)
    )
    chance = random.Random(protocol)
    for _ in range(packets):
        data, bad = chance.randbytes(2), bytearray(make(chance.randrange(253), 0, b"\1\2"))
        # A wrong length makes a splice, and of these a sum of bytes lets 1 in 256 through.
        at = chance.choice((0, 1, 2, 4, 5, 6, 7)) if protocol == 1 else chance.randrange(13)
        bad[at] ^= 1 + chance.randrange(255)
        received = scan(bytes(bad) + make(1, 0, data), (2,), final=True)
        assert [frame.data for frame in received.frames] == [data]
    with capsys.disabled():
        summary = (
            f"B1: protocol {protocol}, {packets} damaged packets, 0 accepted, each next one found"
        )
        sys.stdout.write(f"\n{summary}\n" * (packets > 100_000))


# --- B3: a servo that falls silent costs little time, and is missed at once ---


@pytest.mark.sample(2)
@pytest.mark.usefixtures("plain_line")
@six
@pytest.mark.parametrize("silent", [1, 3, 6])
def test_silent_servo_never_delays_cycle_by_over_5_ms(models, silent):
    bus = make_bus(models)
    goals = goals_of(bus)
    healthy_s = max(cycle(bus, goals) for _ in range(60))
    add_faults(bus, ("silent", {"id": silent}))
    for _ in range(400):
        assert cycle(bus, goals) - healthy_s < 0.005


@six
def test_silent_servo_is_polled_four_times_per_second(models):
    bus = make_bus(models)
    goals = goals_of(bus)
    add_faults(bus, ("silent", {"id": 3}))
    for _ in range(5):
        cycle(bus, goals)
    before, started_s = bus.statistics[3].requests, bus.clock.now_s()
    while bus.clock.now_s() - started_s < 1.0:
        cycle(bus, goals)
    assert bus.statistics[3].requests - before in range(3, 6)


@six
def test_silent_servo_is_reported_in_same_cycle(models):
    bus = make_bus(models)
    goals = goals_of(bus)
    add_faults(bus, ("silent", {"id": 5}))
    readings = bus.sync_read(goals, RegisterName.PRESENT_POSITION)
    assert isinstance(readings.errors[5], ServoSilentError)
    assert "joint_5 (id 5)" in str(readings.errors[5])


@six
def test_servo_that_answers_again_is_read_within_300_ms(models):
    bus = make_bus(models)
    goals = goals_of(bus)
    add_faults(bus, ("silent", {"id": 3, "for_s": 0.1, "at_s": bus.clock.now_s()}))
    end_s = bus.clock.now_s() + 0.4
    while bus.clock.now_s() < end_s:
        cycle(bus, goals)
    assert bus.sync_read(goals, RegisterName.PRESENT_POSITION).require_all().keys() == goals.keys()


# --- B7: what servos complain about stands beside their values ---


@pytest.mark.parametrize("model", ["STS3215", "SCS0009", "AX-12A", "MX-28"])
@pytest.mark.parametrize("bit", [0, 2, 5])
def test_alarm_bit_is_reported_with_next_reply(model, bit):
    bus = make_bus({1: model, 2: model})
    add_faults(bus, ("alarm", {"id": 1, "bits": 1 << bit}))
    bus.clock.sleep_until(bus.clock.now_s() + 0.01)
    readings = bus.sync_read([1, 2], RegisterName.PRESENT_POSITION)
    assert readings.require_all().keys() == {1, 2}
    assert readings.alarms == {1: {bus.servos[1].table.alarm_bits[bit]}}


def test_protocol_2_alert_is_reported_and_explained_on_request():
    bus = make_bus({1: X, 2: X})
    add_faults(bus, ("alarm", {"id": 2, "bits": 0b100000}))
    bus.clock.sleep_until(bus.clock.now_s() + 0.01)
    assert bus.sync_read([1, 2], RegisterName.PRESENT_POSITION).alarms == {2: {Alarm.UNKNOWN}}
    assert bus.read_alarms(2) == {Alarm.OVERLOAD}


# --- B9: a lost instruction is made good by the next ---


@six
def test_goals_arrive_with_10_percent_of_packets_lost(models):
    bus = make_bus(models)
    goals = goals_of(bus)
    add_faults(bus, ("lost", {"probability": 0.1}))
    for step in range(30):
        cycle(bus, {i: tick + step for i, tick in goals.items()})
    last = {i: tick + 29 for i, tick in goals.items()}
    for _ in range(5):
        cycle(bus, last)
    assert {i: s.read("goal_position") for i, s in simulated_servos(bus).items()} == last


# --- B11: torque comes on where the joint stands ---


@pytest.mark.parametrize("model", ["STS3215", X, "MX-28"])
def test_torque_on_moves_joint_by_at_most_two_ticks(model):
    bus = make_bus({1: model})
    servo, chance = simulated_servos(bus)[1], random.Random(1)
    for _ in range(25):
        bus.write(1, RegisterName.TORQUE_ENABLE, 0, raw=True)
        bus.port.transport.line.world.place("servo_1", chance.uniform(-1.0, 1.0))
        bus.clock.sleep_until(bus.clock.now_s() + 0.05)
        stood_tick = servo.read("present_position")
        torque_on(bus, 1)
        bus.clock.sleep_until(bus.clock.now_s() + 0.2)
        assert abs(servo.read("present_position") - stood_tick) <= 2


# --- B12: EEPROM is spared, and half-written EEPROM is mended ---

WANTED = {STS3215.homing_offset: -100, STS3215.p_gain: 16, STS3215.max_torque: 900}


def eeprom_writes(bus):
    return simulated_servos(bus)[1].memory.eeprom_writes


def test_ordinary_bus_use_does_not_write_eeprom():
    bus = make_bus(SIX["Feetech"])
    goals = goals_of(bus)
    before = eeprom_writes(bus)
    for servo_id in goals:
        torque_on(bus, servo_id)
    for _ in range(20):
        cycle(bus, goals)
    update_eeprom(bus, 1, {STS3215.homing_offset: 0})
    assert eeprom_writes(bus) == before


@pytest.mark.parametrize("packet", range(14))
def test_eeprom_update_completes_after_kill_at_any_packet(packet):
    bus = make_bus({1: "STS3215"})
    die_at(bus, packet)
    with pytest.raises(KeyboardInterrupt):
        update_eeprom(bus, 1, WANTED)
    again = bus_with_same_servos(bus)
    update_eeprom(again, 1, WANTED)
    servo = simulated_servos(again)[1]
    assert {r: servo.read(r.name) for r in WANTED} == WANTED
    assert servo.read("lock") == 1


def die_at(bus, packet):
    """End the process when it is about to send this packet."""
    count, write = iter(range(10_000)), bus.port.transport.write

    def deadly(data):
        if next(count) >= packet:
            raise KeyboardInterrupt
        return write(data)

    bus.port.transport.write = deadly


def bus_with_same_servos(bus):
    from ikservo.hardware import Port, ServoBus

    del bus.port.transport.write
    return ServoBus(Port(bus.port.transport, "bench", 1_000_000), list(bus.servos.values()))


@pytest.mark.usefixtures("plain_line")
@pytest.mark.parametrize("model", ["STS3215", X])
def test_eeprom_that_does_not_persist_is_reported_and_locked(model):
    bus = make_bus({1: model})
    bus.port.health = LineHealth(clean_requests=0)  # before that, the write itself would be doubted
    limit = bus.servos[1].table.max_temperature_limit
    servo = simulated_servos(bus)[1]
    put = servo.memory.write

    def worn_out(address, data, **how):
        if address != limit.address:
            put(address, data, **how)

    servo.memory.write = worn_out
    with pytest.raises(ServoRejectedError, match=r"holds .* after 61 was written"):
        update_eeprom(bus, 1, {limit: 61})
    if model == "STS3215":
        assert servo.read("lock") == 1


# --- B13: echo, and bytes that come one by one ---


@six
@pytest.mark.parametrize("adapter", [PLAIN, ECHO], ids=["plain", "echo"])
def test_reply_received_in_single_bytes_is_assembled(models, adapter, monkeypatch):
    bus = make_bus(models, adapter=adapter)
    read = bus.port.transport.read
    monkeypatch.setattr(bus.port.transport, "read", lambda size=1: read(min(size, 1)))
    ticks = bus.sync_read(models, RegisterName.PRESENT_POSITION, raw=True).require_all()
    held = {i: servo.read("present_position") for i, servo in simulated_servos(bus).items()}
    assert ticks == held


# --- speed ---


@pytest.mark.usefixtures("plain_line")
@six
def test_six_servo_cycle_uses_85_percent_of_bus_bandwidth(models):
    bus = make_bus(models)
    goals = goals_of(bus)
    for _ in range(60):
        cycle(bus, goals)
    took_s = sum(cycle(bus, goals) for _ in range(100)) / 100
    assert wire_s(bus) / took_s > 0.85


def wire_s(bus):
    """Return the shortest wire time of a cycle's packets, with the fastest instructions."""
    if bus.servos[1].table is STS3215:
        return bus.port.wire_s((8 + 6 * 3) + (8 + 6) + 6 * 8)
    return bus.port.wire_s((14 + 6 * 5) + (14 + 6) + (8 + 6 * 8))


@pytest.mark.usefixtures("plain_line")
def test_silent_bus_raises_bus_error_within_50_ms():
    bus = make_bus(SIX["Feetech"])
    add_faults(bus, ("silent", {}))
    started_s = bus.clock.now_s()
    with pytest.raises(BusError, match=r"No servo answers\. Check the power supply"):
        bus.sync_read(bus.servos, RegisterName.PRESENT_POSITION).require_all()
    assert bus.clock.now_s() - started_s < 0.05
