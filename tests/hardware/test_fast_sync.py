"""Fast sync read: all servos in one packet, and the fallback if that fails."""

from __future__ import annotations

import pytest

from ikservo.errors import ServoRejectedError
from ikservo.hardware import Port, ServoBus, ServoSpec
from ikservo.hardware.protocols.dynamixel import DynamixelDriver
from ikservo.hardware.protocols.protocol2 import split_fast_sync
from ikservo.registers import XL430W250, Alarm, RegisterName

from .factories import make_transport

FAST = "FF FF FD 00 FE 0A 00 8A 84 00 04 00 03 07 04 20 F2"
COMBINED = (
    "FF FF FD 00 FE 19 00 55 00 03 A6 00 00 00 84 08 00 07 1F 08 00 00 16 CA "
    "00 04 FF 03 00 00 D1 9E"
)
SLOW = "FF FF FD 00 FE 0A 00 82 84 00 04 00 03 07 04 10 72"
SLOW_3 = "FF FF FD 00 03 08 00 55 00 A6 00 00 00 4F 4C"
SLOW_7 = "FF FF FD 00 07 08 00 55 00 1F 08 00 00 5A A1"
SLOW_4 = "FF FF FD 00 04 08 00 55 00 FF 03 00 00 4B AB"
TICKS = {3: 166, 7: 2079, 4: 1023}


@pytest.fixture
def bus(port):
    """Return a bus that tries fast sync read first."""
    return ServoBus(port, [ServoSpec(i, XL430W250) for i in (3, 7, 4)], retries=0)


def read(bus):
    return bus.sync_read((3, 7, 4), RegisterName.PRESENT_POSITION, raw=True)


def test_fast_sync_read_gets_all_values_from_one_packet(bus, line):
    line.expect(FAST, COMBINED)
    assert read(bus).require_all() == TICKS


def test_damaged_fast_sync_reply_is_read_again_by_sync_read(bus, line):
    line.expect(FAST, COMBINED.replace("1F 08", "1F 09"))
    line.expect(SLOW, SLOW_3, SLOW_7, SLOW_4)
    assert read(bus).require_all() == TICKS


def test_missing_servo_in_fast_sync_does_not_affect_other_values(bus, line):
    line.expect(FAST, "FF FF FD 00 FE 19 00 55 00 03 A6 00 00 00 84 08")
    line.expect(SLOW, SLOW_3, SLOW_4)
    assert read(bus).values == {3: 166, 4: 1023}


def test_fast_sync_read_is_disabled_after_two_failures(bus, line):
    for _ in range(2):
        line.expect(FAST).expect(SLOW, SLOW_3, SLOW_7, SLOW_4)
    line.expect(SLOW, SLOW_3, SLOW_7, SLOW_4)
    for _ in range(3):
        line.clock.s += 0.3  # nothing is owed any more
        assert read(bus).require_all() == TICKS


def test_fast_sync_read_success_resets_failure_count(bus, line):
    line.expect(FAST).expect(SLOW, SLOW_3, SLOW_7, SLOW_4)
    line.expect(FAST, COMBINED)
    line.expect(FAST).expect(SLOW, SLOW_3, SLOW_7, SLOW_4)
    line.expect(FAST, COMBINED)
    for _ in range(4):
        line.clock.s += 0.3  # nothing is owed any more
        assert read(bus).require_all() == TICKS


def test_fast_sync_read_asks_for_more_while_reply_is_pending(bus, line):
    line.expect(FAST).expect(SLOW, SLOW_3, SLOW_7, SLOW_4)
    line.expect("FF FF FD 00 FE 0A 00 8A 83 00 05 00 03 07 04 28 F5")
    line.expect(SLOW, SLOW_3, SLOW_7, SLOW_4)
    for _ in range(2):
        assert read(bus).require_all() == TICKS


def test_fast_sync_reports_alert_per_servo(bus, line):
    line.expect(
        FAST,
        "FF FF FD 00 FE 19 00 55 00 03 A6 00 00 00 84 08 80 07 1F 08 00 00 9D 4A "
        "00 04 FF 03 00 00 58 A5",
    )
    readings = read(bus)
    assert readings.require_all() == TICKS
    assert readings.alarms == {7: {Alarm.UNKNOWN}}


def test_fast_sync_reports_rejection_per_servo(bus, line):
    line.expect(
        FAST,
        "FF FF FD 00 FE 19 00 55 00 03 A6 00 00 00 84 08 07 07 00 00 00 00 B5 AE "
        "00 04 FF 03 00 00 18 A7",
    )
    readings = read(bus)
    assert readings.values == {3: 166, 4: 1023}
    assert isinstance(readings.errors[7], ServoRejectedError)


def test_fast_sync_read_is_tried_again_after_200_sync_reads(bus, line):
    for _ in range(2):
        line.expect(FAST).expect(SLOW, SLOW_3, SLOW_7, SLOW_4)
    for _ in range(198):
        line.expect(SLOW, SLOW_3, SLOW_7, SLOW_4)
    line.expect(FAST, COMBINED)
    for _ in range(201):
        line.clock.s += 0.3  # nothing is owed any more
        assert read(bus).require_all() == TICKS


def waited_s(return_delay_s):
    """Return the wait for two absent servos, fast and then one by one."""
    port = Port(make_transport({1: "XL430-W250"}), "bench", 1_000_000)
    driver = DynamixelDriver(port)
    driver.set_return_delay(return_delay_s)
    begun_s = port.clock.now_s()
    driver.sync_read([3, 4], 132, 4)
    return port.clock.now_s() - begun_s


def test_fast_and_plain_sync_read_wait_for_return_delay():
    delays_s = waited_s(0.000_5) - waited_s(0.0)
    assert delays_s == pytest.approx(3 * 0.000_5, abs=1e-5)  # once fast, then once for each


@pytest.mark.parametrize("size", range(1, 40))
def test_fast_sync_reply_of_wrong_length_is_discarded(size):
    whole = bytes((0, 1, 5, 6, 9, 9, 0, 2, 7, 8))
    data = (whole * 4)[:size]
    parts = split_fast_sync(data, (1, 2), 2)
    assert [part.data for part in parts] == ([b"\5\6", b"\7\x08"] if data == whole else [])
