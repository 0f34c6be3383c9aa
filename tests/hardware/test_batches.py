"""Many servos, several families, two lines and two threads: as few packets as possible."""

from __future__ import annotations

import threading

import pytest

from ikservo.errors import RegisterAccessError, ServoSilentError
from ikservo.hardware import ServoBus, ServoSpec, torque_off, torque_on
from ikservo.registers import MX28, STS3215, XL430W250, Family, RegisterName

from .factories import add_faults, make_bus, simulated_servos

X = "XL430-W250"
MIXED = {1: "STS3215", 2: X, 3: "AX-12A", 4: "SCS0009", 5: "MX-28", 6: "XM430-W350"}


@pytest.fixture
def written(monkeypatch):
    """Return a function that records what a bus sends, packet by packet."""

    def listen(bus):
        sent, write = [], bus.port.transport.write
        monkeypatch.setattr(
            bus.port.transport, "write", lambda data: (sent.append(bytes(data)), write(data))[1]
        )
        return sent

    return listen


APART = {1: [XL430W250.present_temperature], 2: [XL430W250.present_position]}


class TestBulk:
    """Different registers of several servos in one packet, if the family has a packet for it."""

    def test_bulk_read_of_protocol_2_sends_one_packet(self, written):
        bus = make_bus({1: X, 2: X})
        sent = written(bus)
        readings = bus.bulk_read(APART, raw=True).require_all()
        assert [packet[7] for packet in sent] == [0x92]
        servos = simulated_servos(bus)
        assert readings[1] == {XL430W250.present_temperature: servos[1].read("present_temperature")}
        assert readings[2] == {XL430W250.present_position: servos[2].read("present_position")}

    def test_bulk_read_of_mx_servos_sends_one_packet(self, written):
        bus = make_bus({1: "MX-28", 2: "MX-28"})
        sent = written(bus)
        bus.bulk_read({1: [MX28.present_voltage], 2: [MX28.present_position]}).require_all()
        assert [packet[4] for packet in sent] == [0x92]

    def test_sync_read_of_mx_servos_sends_one_bulk_read(self, written):
        bus = make_bus({1: "MX-28", 2: "MX-28"})
        sent = written(bus)
        bus.sync_read([1, 2], RegisterName.PRESENT_POSITION).require_all()
        assert [packet[4] for packet in sent] == [0x92]

    def test_ax_servo_among_mx_servos_is_read_separately(self, written):
        bus = make_bus({1: "MX-28", 2: "AX-12A", 3: "MX-28"})
        sent = written(bus)
        bus.sync_read([1, 2, 3], RegisterName.PRESENT_POSITION).require_all()
        assert [packet[4] for packet in sent] == [0x92, 0x02]

    def test_bulk_read_of_feetech_sends_one_packet_per_register(self, written):
        bus = make_bus({1: "STS3215", 2: "STS3215", 3: "STS3215"})
        sent = written(bus)
        at, heat = [STS3215.present_position], [STS3215.present_temperature]
        bus.bulk_read({1: at, 2: heat, 3: at}).require_all()
        assert [packet[4] for packet in sent] == [0x82, 0x82]

    def test_bulk_write_sends_one_packet_for_different_registers(self, written):
        bus = make_bus({1: X, 2: X})
        torque_on(bus, 2)
        sent = written(bus)
        bus.bulk_write({1: {XL430W250.led: 1}, 2: {XL430W250.goal_position: 2100}}, raw=True)
        assert [packet[7] for packet in sent] == [0x93]
        bus.ping(1)  # a write to many is not answered: the next answer comes behind it
        servos = simulated_servos(bus)
        assert (servos[1].read("led"), servos[2].read("goal_position")) == (1, 2100)

    def test_bulk_write_of_adjacent_registers_is_one_sync_write(self, written):
        bus = make_bus({1: X, 2: X})
        for servo_id in (1, 2):
            torque_on(bus, servo_id)
        sent = written(bus)
        row = {RegisterName.PROFILE_VELOCITY: 100, RegisterName.GOAL_POSITION: 2100}
        bus.bulk_write({1: row, 2: row}, raw=True)
        assert [packet[7] for packet in sent] == [0x83]
        bus.ping(1)
        assert simulated_servos(bus)[2].read("profile_velocity") == 100

    def test_bulk_write_with_bad_value_sends_nothing(self, written):
        bus = make_bus({1: X, 2: X})
        sent = written(bus)
        with pytest.raises(RegisterAccessError, match="joint_2"):
            bus.bulk_write(
                {1: {RegisterName.GOAL_POSITION: 1}, 2: {RegisterName.GOAL_POSITION: 1 << 30}},
                raw=True,
            )
        assert sent == []

    def test_bulk_read_reports_silent_servo_and_values_of_others(self):
        bus = make_bus({1: X, 2: X})
        add_faults(bus, ("silent", {"id": 1}))
        readings = bus.bulk_read(APART, raw=True)
        assert readings.values.keys() == {2}
        assert isinstance(readings.errors[1], ServoSilentError)


class TestMixedFamilies:
    """Six models with four protocols on one line."""

    @pytest.fixture
    def bus(self):
        return make_bus(MIXED)

    def test_sync_read_reads_mixed_families_in_one_call(self, bus):
        ticks = bus.sync_read(MIXED, RegisterName.PRESENT_POSITION, raw=True).require_all()
        held = {i: s.read("present_position") for i, s in simulated_servos(bus).items()}
        assert ticks == held

    def test_sync_write_writes_mixed_families_in_one_call(self, bus):
        goals = {i: torque_on(bus, i) + 5 for i in MIXED}
        bus.sync_write(RegisterName.GOAL_POSITION, goals, raw=True)
        bus.ping(1)
        assert {i: s.read("goal_position") for i, s in simulated_servos(bus).items()} == goals

    def test_torque_off_reaches_all_servos_although_two_are_silent(self, bus):
        bus.sync_write(RegisterName.TORQUE_ENABLE, dict.fromkeys(MIXED, 1), raw=True)
        add_faults(bus, ("lost", {"count": 0}), ("silent", {"id": 2}), ("silent", {"id": 5}))
        assert list(torque_off(bus, MIXED)) == [2, 5]
        assert {s.read("torque_enable") for s in simulated_servos(bus).values()} == {0}


class TestShadows:
    """A shadow servo obeys its leader's writes without a reply, and is read at its own id."""

    @pytest.fixture
    def bus(self):
        bus = make_bus({2: X, 3: X})
        simulated_servos(bus)[3].write("secondary_id", 2)
        return bus

    def test_goal_is_sent_to_both_servos_of_joint(self, bus):
        torque_on(bus, 2)
        bus.write(2, RegisterName.GOAL_POSITION, 2100, raw=True)
        assert {s.read("goal_position") for s in simulated_servos(bus).values()} == {2100}

    def test_sync_read_returns_values_of_both_servos_of_joint(self, bus):
        readings = bus.sync_read([2, 3], RegisterName.PRESENT_POSITION, raw=True).require_all()
        assert readings.keys() == {2, 3}
        assert bus.statistics[2].lost == bus.statistics[2].garbled == 0


def test_two_buses_are_read_by_two_threads_at_once():
    buses = [make_bus({1: X, 2: X}), make_bus({1: "STS3215", 2: "STS3215"})]
    found = [[], []]

    def talk(k):
        for _ in range(200):
            readings = buses[k].sync_read([1, 2], RegisterName.MODEL_NUMBER, raw=True)
            found[k].append(tuple(readings.require_all().values()))

    threads = [threading.Thread(target=talk, args=(k,)) for k in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(timeout=30)
    assert [set(rows) for rows in found] == [{(1060, 1060)}, {(777, 777)}]
    assert [len(rows) for rows in found] == [200, 200]


def test_two_threads_share_one_bus_without_interference():
    bus = make_bus({1: X, 2: "STS3215"})
    found = {1: set(), 2: set()}

    def talk(servo_id):
        for _ in range(200):
            found[servo_id].add(bus.read(servo_id, RegisterName.MODEL_NUMBER, raw=True))

    threads = [threading.Thread(target=talk, args=(i,)) for i in found]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(timeout=30)
    assert found == {1: {1060}, 2: {777}}


class TestRollCall:
    """A broadcast ping that ends as soon as no servo can answer any more."""

    def test_broadcast_ping_finds_all_protocol_2_servos(self):
        bus = make_bus(dict.fromkeys((1, 5, 9), X))
        called = bus.broadcast_ping(Family.DYNAMIXEL_2)
        assert called.replies.keys() == {1, 5, 9}
        assert {answer.data[:2] for (answer,) in called.replies.values()} == {b"\x24\x04"}

    def test_broadcast_ping_finds_all_feetech_servos(self):
        bus = make_bus(dict.fromkeys((1, 2, 6), "STS3215"))
        assert bus.broadcast_ping(Family.FEETECH_STS).replies.keys() == {1, 2, 6}

    def test_broadcast_ping_takes_less_than_100_ms(self):
        bus = make_bus(dict.fromkeys(range(1, 7), X))
        started_s = bus.clock.now_s()
        bus.broadcast_ping(Family.DYNAMIXEL_2)
        assert bus.clock.now_s() - started_s < 0.1  # the SDK's own: 0.8

    def test_broadcast_ping_finds_unknown_servos(self):
        bus = make_bus({1: X, 200: X})
        known = ServoBus(bus.port, [ServoSpec(1, XL430W250)])
        assert known.broadcast_ping(Family.DYNAMIXEL_2, highest_id=252).replies.keys() == {1, 200}

    @pytest.mark.parametrize("model", [X, "STS3215"])
    def test_broadcast_ping_detects_duplicate_id(self, model):
        transport_bus = make_bus({1: model})
        family = transport_bus.servos[1].table.family
        bus = crowded(model)
        called = bus.broadcast_ping(family)
        assert called.junk or len(called.replies.get(4, ())) > 1


def crowded(model):
    """Return a bus with two servos at id 4."""
    from ikservo.hardware import Port

    from .factories import make_transport

    transport = make_transport([(4, model), (4, model)])
    known = make_bus({4: model}).servos[4]
    return ServoBus(Port(transport, "bench", 1_000_000), [known])
