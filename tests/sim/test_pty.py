"""The line on a pseudo-terminal, if its server is late."""

import os
import sys
import time

import pytest

from servosim.assembly import BenchServo, make_bench_world
from servosim.frames import checksum
from servosim.line import Line

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no pseudo-terminals")

BAUD = 1_000_000
PING_1, PING_2 = bytes.fromhex("FFFF010201FB"), bytes.fromhex("FFFF020201FA")
SYNC_READ = bytes.fromhex("FFFFFE068238020102")
ANSWER_1, ANSWER_2 = bytes.fromhex("FFFF010200FC"), bytes.fromhex("FFFF020200FB")


@pytest.fixture
def bus():
    """Return two servos on a pseudo-terminal that is served only when the test says so."""
    from servosim.pty import PtyBus  # its modules are not there on Windows

    world = make_bench_world([BenchServo(1, "STS3215"), BenchServo(2, "STS3215")], baud=BAUD)
    bus = PtyBus(Line(world, BAUD))
    bus.follow_baud = False
    yield bus
    bus.unplug()


@pytest.fixture
def client(bus):
    """Return the client's end of the terminal."""
    fd = os.open(bus.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    yield fd
    os.close(fd)


@pytest.fixture
def hold_up(monkeypatch):
    """Return a function that lets the machine's time pass while the server does not run."""
    missed_s, now_s = [], time.monotonic
    monkeypatch.setattr(time, "monotonic", lambda: now_s() + sum(missed_s))
    return missed_s.append


def received(bus, client, size):
    """Serve until the given number of bytes has come back, at most 2 s; return them."""
    data, end_s = b"", time.monotonic() + 2.0
    while len(data) < size and time.monotonic() < end_s:
        bus.process_events()
        try:
            data += os.read(client, 1 << 12)
        except BlockingIOError:
            continue
    return data


def test_pings_sent_before_simulator_runs_are_all_answered(bus, client):
    os.write(client, 20 * (PING_1 + PING_2))
    assert received(bus, client, 240) == 20 * (ANSWER_1 + ANSWER_2)


def test_pings_sent_during_simulated_replies_are_all_answered(bus, client):
    for _ in range(20):
        os.write(client, PING_1)
        bus.process_events()
    assert received(bus, client, 120) == 20 * ANSWER_1


def test_simulator_answers_read_queued_behind_sync_read(bus, client):
    sync_read = SYNC_READ + bytes([checksum(SYNC_READ[2:])])
    os.write(client, sync_read + PING_1)
    data = received(bus, client, 8 + 8 + 6)
    assert len(data) == 8 + 8 + 6
    assert data.endswith(ANSWER_1)


def test_simulated_time_hardly_advances_during_server_stall(bus, client, hold_up):
    world = bus.line.world
    bus.process_events()
    before_s = world.time_s
    hold_up(100.0)
    os.write(client, PING_1)
    assert received(bus, client, 6) == ANSWER_1
    assert world.time_s - before_s < 10.0


def test_servo_continues_from_its_position_after_server_stall(bus, client, hold_up):
    servo = bus.line.servos[1]
    servo.write("goal_speed", 500)
    servo.write("goal_position", servo.read("present_position") + 1000)
    bus.process_events()
    before_tick = servo.read("present_position")
    hold_up(100.0)
    bus.process_events()
    assert servo.read("present_position") - before_tick < 100


def test_simulated_time_catches_up_after_small_delay(bus, client, hold_up):
    world = bus.line.world
    bus.process_events()
    before_s = world.time_s
    hold_up(0.025)
    bus.process_events()
    assert world.time_s - before_s > 0.024
