"""Late and doubled replies: protocols do not number them, so requests are spaced in time."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ikservo.errors import BadReplyError, BusError, ServoSilentError
from ikservo.hardware.late_replies import (
    MAX_REPLY_DELAY_S,
    AdaptiveTimeout,
    ByteRateCheck,
    LineHealth,
    PendingReplies,
)
from ikservo.hardware.packets import MemoryRange
from ikservo.registers import STS3215, XL430W250, RegisterName

from .factories import add_faults, make_bus, simulated_servos
from .packets import reply, request, sync_request

X = "XL430-W250"
LIMITS = {"STS3215": STS3215.max_position_limit, X: XL430W250.max_position_limit}
OTHERS = {"STS3215": STS3215.min_position_limit, X: XL430W250.min_position_limit}
both = pytest.mark.parametrize("model", LIMITS)


@pytest.fixture
def bus(model):
    """Return a bus without retries on a line that it knows as clean and fast."""
    bus = make_bus({1: model}, retries=0)
    bus.port.health, bus.port.reply_timeout = (
        LineHealth(clean_requests=0),
        AdaptiveTimeout(0.001, 0.001),
    )
    return bus


def value_or_loss(bus, register):
    """Return the value, or "lost": an old reply may collide with the new one on the wire."""
    try:
        return bus.read(1, register, raw=True)
    except BusError:
        return "lost"


@both
@pytest.mark.parametrize("delay_s", [0.005, 0.01, 0.02, 0.05, 0.1, 0.2])
def test_late_reply_is_never_taken_for_later_request(bus, model, delay_s):
    add_faults(bus, ("late", {"delay_s": delay_s, "count": 1}))
    held = simulated_servos(bus)[1].read(OTHERS[model].name)
    with pytest.raises(ServoSilentError):
        bus.read(1, LIMITS[model])
    while bus.clock.now_s() < delay_s + 0.05:
        assert value_or_loss(bus, OTHERS[model]) in (held, "lost")


@both
@pytest.mark.parametrize("delay_s", [0.0, 1e-5, 1e-4, 1e-3, 0.005, 0.015])
def test_duplicate_reply_is_never_taken_for_another_request(bus, model, delay_s):
    add_faults(bus, ("duplicated", {"delay_s": delay_s, "count": 1}))
    held = simulated_servos(bus)[1].read(OTHERS[model].name)
    bus.read(1, LIMITS[model])
    while bus.clock.now_s() < delay_s + 0.01:
        assert value_or_loss(bus, OTHERS[model]) in (held, "lost")


@both
def test_late_write_reply_is_not_taken_for_next_write(bus, model):
    bus.write(1, RegisterName.TORQUE_ENABLE, 1, raw=True)
    now_s = bus.clock.now_s()
    add_faults(
        bus,
        ("late", {"delay_s": 0.003, "count": 1}),
        ("lost", {"at_s": now_s + 0.0016, "count": 1}),
    )
    with pytest.raises(ServoSilentError):
        bus.write(1, RegisterName.GOAL_POSITION, 2000, raw=True)
    with pytest.raises((ServoSilentError, BadReplyError)):
        bus.write(1, RegisterName.GOAL_POSITION, 2100, raw=True)
    assert simulated_servos(bus)[1].read("goal_position") == 2000


def test_write_that_cannot_be_retried_waits_for_late_replies(feetech, line):
    line.expect("FF FF 01 04 03 28 01 CE")
    line.expect("FF FF 01 04 03 28 80 4F", reply(1))
    with pytest.raises(ServoSilentError):
        feetech.write(1, STS3215.torque_enable, 1)
    feetech.write(1, STS3215.torque_enable, 128, raw=True)
    assert line.clock.s > MAX_REPLY_DELAY_S


class TestHealthyLine:
    """The precautions cost next to nothing on a healthy line."""

    def test_repeated_sync_read_is_sent_unchanged(self, feetech, line):
        for _ in range(20):
            line.expect(sync_request([1, 2], 56, 2), reply(1, 0, 8), reply(2, 0, 8))
            feetech.sync_read([1, 2], RegisterName.PRESENT_POSITION)

    def test_other_read_within_20_ms_requests_one_more_byte(self, feetech, line):
        line.expect(request(1, 9, 2), reply(1, 0, 0)).expect(
            request(1, 10, 3), reply(1, 0, 255, 15)
        )
        feetech.read(1, STS3215.min_position_limit)
        assert feetech.read(1, STS3215.max_position_limit, raw=True) == 4095

    def test_other_read_after_20_ms_keeps_its_length(self, feetech, line):
        line.expect(request(1, 9, 2), reply(1, 0, 0)).expect(request(1, 11, 2), reply(1, 255, 15))
        feetech.read(1, STS3215.min_position_limit)
        line.clock.s += 0.021
        feetech.read(1, STS3215.max_position_limit)

    def test_read_of_another_servo_keeps_requested_length(self, feetech, line):
        line.expect(request(1, 9, 2), reply(1, 0, 0)).expect(request(2, 11, 2), reply(2, 255, 15))
        feetech.read(1, STS3215.min_position_limit)
        feetech.read(2, STS3215.max_position_limit)


class TestNewOrOddLine:
    """Until a line has been clean for a while, constant values are read twice."""

    @pytest.fixture
    def suspecting_bus(self, feetech, port):
        port.health = LineHealth(clean_requests=5)
        return feetech

    def test_two_equal_readings_are_accepted_on_unreliable_line(self, suspecting_bus, line):
        line.expect(request(1, 9, 2), reply(1, 5, 0)).expect(request(1, 9, 2), reply(1, 5, 0))
        assert suspecting_bus.read(1, STS3215.min_position_limit, raw=True) == 5

    def test_two_different_readings_on_unreliable_line_are_refused(self, suspecting_bus, line):
        line.expect(request(1, 9, 2), reply(1, 5, 0)).expect(request(1, 9, 2), reply(1, 6, 0))
        with pytest.raises(BadReplyError, match="a second read did not confirm"):
            suspecting_bus.read(1, STS3215.min_position_limit)

    def test_position_is_read_only_once_even_on_unreliable_line(self, suspecting_bus, line):
        line.expect(request(1, 56, 2), reply(1, 0, 8))
        assert suspecting_bus.read(1, STS3215.present_position, raw=True) == 2048

    def test_unexpected_reply_makes_repeated_requests_vary_in_length(self, feetech, port, line):
        port.health.record(odd=True)
        line.expect(request(1, 56, 2), reply(1, 0, 8)).expect(request(1, 55, 3), reply(1, 0, 0, 8))
        for _ in range(2):
            assert feetech.read(1, STS3215.present_position, raw=True) == 2048

    def test_bus_line_is_trusted_again_after_300_clean_requests(self):
        trust = LineHealth(clean_requests=0)
        trust.record(odd=True)
        for _ in range(300):
            assert trust.degraded
            trust.record(odd=False)
        assert not trust.suspect


class TestPace:
    """More bytes than the wire could have carried are older than the request."""

    def test_byte_rate_check_without_history_reports_no_excess(self):
        assert ByteRateCheck().excess_bytes(8, 0.0, 1e-5) == 0

    def test_byte_rate_check_reports_bytes_arriving_too_early(self):
        assert self.known().excess_bytes(8, 0.0, 1e-5) == 7
        assert self.known().excess_bytes(8, 8e-5, 1e-5) == 0

    def test_byte_rate_check_adapts_after_one_faster_reply(self):
        pace = self.known()
        pace.on_reply(8, 0.0, 1e-5)
        assert pace.excess_bytes(8, 0.0, 1e-5) == 0

    @staticmethod
    def known():
        pace = ByteRateCheck()
        for _ in range(16):
            pace.on_reply(8, 1e-4, 1e-5)
        return pace


spans = st.builds(MemoryRange, st.integers(0, 200), st.integers(1, 4))
histories = st.lists(st.tuples(spans, st.booleans(), st.floats(0.0, 0.05)), max_size=20)


@given(history=histories, wanted=spans, is_degraded=st.booleans())
def test_extended_read_never_has_length_of_pending_reply(history, wanted, is_degraded):
    late_replies, trust, now_s = PendingReplies(), LineHealth(clean_requests=0), 0.0
    if is_degraded:
        trust.record(odd=True)
    owed = []
    for span, answered, pause_s in history:
        window = late_replies.distinct_window((1,), span, now_s, trust)
        if answered:
            late_replies.record_received((1,), window.size, window, now_s)
        else:
            late_replies.add_pending(1, window.size, now_s)
            owed.append((window.size, now_s + MAX_REPLY_DELAY_S))
        now_s += pause_s
    window = late_replies.distinct_window((1,), wanted, now_s, trust)
    assert window.size not in {size for size, until_s in owed if until_s > now_s}
    assert window.address <= wanted.address
    assert wanted.end <= window.end or window.address == 0


@given(span=spans, by=st.integers(0, 24), data=st.binary(min_size=300, max_size=300))
def test_extended_read_contains_original_registers(span, by, data):
    window = span.grown(by)
    assert window.size == span.size + by
    assert 0 <= window.address <= span.address
    assert span.end <= window.end


def test_reply_to_extended_read_is_cut_to_requested_bytes(feetech, line):
    line.expect("FF FF 01 04 02 38 02 BE").expect(request(1, 55, 3), reply(1, 99, 0, 8))
    with pytest.raises(ServoSilentError):
        feetech.read(1, RegisterName.PRESENT_POSITION)
    assert feetech.read(1, RegisterName.PRESENT_POSITION, raw=True) == 2048
