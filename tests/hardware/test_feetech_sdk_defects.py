"""Each defect of scservo_sdk that can affect an arm: the SDK has it, our driver does not.

Not here: F15 (no code here sends the instructions for recovery and offset calibration).
"""

from __future__ import annotations

import os
import threading

import pytest
import scservo_sdk
from scservo_sdk.scservo_def import COMM_PORT_BUSY, COMM_RX_CORRUPT, COMM_RX_TIMEOUT, COMM_SUCCESS

from ikservo.errors import BadReplyError, PortBusyError, ServoRejectedError, ServoSilentError
from ikservo.hardware import ServoBus, ServoSpec, open_port
from ikservo.hardware.protocols.feetech import FeetechDriver
from ikservo.registers import STS3215, Alarm, RegisterName

POSITION = STS3215.present_position
READ_POSITION = "FF FF 01 04 02 38 02 BE"
AT_2048 = "FF FF 01 04 00 00 08 F2"
AT_5 = "FF FF 01 04 00 05 00 F5"
PING = "FF FF 01 02 01 FB"


@pytest.fixture
def stock(stock_port):
    """Return the SDK's own handler and port."""
    return scservo_sdk.PacketHandler(0), stock_port(scservo_sdk.PortHandler)


class TestF1StaleInput:
    """clearPort waits for output and discards no input."""

    def test_sdk_mistakes_late_reply_for_next_one(self, stock, line):
        handler, port = stock
        line.add_stale(AT_5)
        line.expect(READ_POSITION, AT_2048)
        assert handler.read2ByteTxRx(port, 1, 56) == (5, COMM_SUCCESS, 0)

    def test_driver_discards_late_reply(self, feetech, line):
        line.add_stale(AT_5)
        line.expect(READ_POSITION, AT_2048)
        assert feetech.read(1, POSITION, raw=True) == 2048

    def test_driver_varies_request_length_to_reject_late_reply(self, feetech, line):
        line.expect(READ_POSITION, AT_5, after_s=0.0028)
        line.expect("FF FF 01 04 02 37 03 BE", "FF FF 01 05 00 01 00 08 F0")
        with pytest.raises(ServoSilentError):
            feetech.read(1, POSITION)
        assert feetech.read(1, POSITION, raw=True) == 2048


class TestF2Timeout:
    """The SDK waits 34 ms for a reply that takes 0.2 ms."""

    def test_sdk_waits_34_ms_for_silent_servo(self, stock, line):
        handler, port = stock
        line.expect(READ_POSITION)
        assert handler.read2ByteTxRx(port, 1, 56)[1] == COMM_RX_TIMEOUT
        assert line.clock.s > 0.034

    def test_driver_waits_under_5_ms_for_silent_servo(self, feetech, line):
        line.expect(READ_POSITION)
        with pytest.raises(ServoSilentError):
            feetech.read(1, POSITION)
        assert line.clock.s < 0.005


class TestF3WallClock:
    """Timeouts are measured on a clock that people and NTP set."""

    def test_sdk_time_out_uses_wall_clock(self, stock, line, monkeypatch):
        _, port = stock
        monkeypatch.setattr("time.time", lambda: 1_000.0)
        moment = scservo_sdk.PortHandler.getCurrentTime(port)
        monkeypatch.setattr("time.time", lambda: 4_600.0)
        assert scservo_sdk.PortHandler.getCurrentTime(port) - moment == 3_600_000.0

    def test_driver_time_out_does_not_use_wall_clock(self, feetech, line, monkeypatch):
        monkeypatch.setattr("time.time", lambda: pytest.fail("looked at the wall clock"))
        line.expect(READ_POSITION, AT_2048)
        assert feetech.read(1, POSITION, raw=True) == 2048


class TestF4BusyWait:
    """The SDK reads without waiting, over and over."""

    def test_sdk_polls_port_over_30_times_for_silent_servo(self, stock, line):
        handler, port = stock
        line.expect(READ_POSITION)
        handler.read2ByteTxRx(port, 1, 56)
        assert line.reads > 30

    def test_driver_waits_for_silent_servo_in_at_most_two_reads(self, feetech, line):
        line.expect(READ_POSITION)
        with pytest.raises(ServoSilentError):
            feetech.read(1, POSITION)
        assert line.reads <= 2


class TestF5TwoPrograms:
    """The SDK opens a port that is already open."""

    def test_sdk_opens_same_port_twice(self, pty_name):
        ports = [scservo_sdk.PortHandler(pty_name) for _ in range(2)]
        assert [port.openPort() for port in ports] == [True, True]
        for port in ports:
            port.closePort()

    def test_port_refuses_second_open_with_owner_process(self, pty_name):
        with (
            open_port(pty_name, 1_000_000),
            pytest.raises(PortBusyError, match=f"process {os.getpid()}"),
        ):
            open_port(pty_name, 1_000_000)


class TestF6BaudRates:
    """The SDK's list lacks rates that the servos have."""

    def test_sdk_keeps_old_baud_rate_without_error(self, stock):
        _, port = stock
        assert port.setBaudRate(76_800) is False
        assert port.getBaudRate() == 1_000_000

    @pytest.mark.parametrize("rate", [76_800, 250_000, 2_000_000, 4_500_000])
    def test_port_accepts_every_baud_rate(self, pty_name, rate):
        with open_port(pty_name, 1_000_000) as port:
            port.setBaudRate(rate)
            assert port.getBaudRate() == rate


class TestF7RefusalWithoutData:
    """An error reply without data is read as if it had some."""

    NO_DATA = "FF FF 01 02 20 DC"

    def test_sdk_returns_checksum_as_value_of_empty_reply(self, stock, line):
        handler, port = stock
        line.expect("FF FF 01 04 02 3F 01 B8", self.NO_DATA)
        assert handler.read1ByteTxRx(port, 1, 63) == (0xDC, COMM_SUCCESS, 0x20)

    def test_driver_reports_reply_without_data(self, feetech, line):
        line.expect("FF FF 01 04 02 3F 01 B8", self.NO_DATA)
        with pytest.raises(ServoRejectedError, match="without data"):
            feetech.read(1, STS3215.present_temperature)


class TestF8BusyFlag:
    """After an exception in mid-reception every later call finds the port busy."""

    @pytest.fixture
    def unplugged_once(self, line, monkeypatch):
        readings = iter([OSError("unplugged")])
        read = line.read

        def failing_once(size=1):
            for error in readings:
                raise error
            return read(size)

        monkeypatch.setattr(line, "read", failing_once)
        line.expect(READ_POSITION)

    def test_sdk_stays_busy_after_unplug_error(self, stock, unplugged_once):
        handler, port = stock
        with pytest.raises(OSError, match="unplugged"):
            handler.read2ByteTxRx(port, 1, 56)
        assert handler.read2ByteTxRx(port, 1, 56)[1] == COMM_PORT_BUSY

    def test_driver_works_again_after_unplug_error(self, feetech, line, unplugged_once):
        with pytest.raises(OSError, match="unplugged"):
            feetech.read(1, POSITION)
        line.expect(READ_POSITION, AT_2048)
        assert feetech.read(1, POSITION, raw=True) == 2048


class TestF9ByteOrder:
    """The byte order is a global of the SDK's module: the last handler determines it."""

    @pytest.fixture(autouse=True)
    def _big_endian_neighbour(self):
        yield scservo_sdk.PacketHandler(1)
        scservo_sdk.PacketHandler(0)

    def test_sdk_swaps_byte_order_after_use_of_other_servo_family(self, stock, line):
        handler, port = stock
        scservo_sdk.PacketHandler(1)
        line.expect(READ_POSITION, AT_2048)
        assert handler.read2ByteTxRx(port, 1, 56)[0] == 8

    def test_driver_uses_byte_order_of_register(self, feetech, line):
        line.expect(READ_POSITION, AT_2048)
        assert feetech.read(1, POSITION, raw=True) == 2048


class TestF10SilentServoInSyncRead:
    """One silent servo costs the replies of all behind it."""

    ASKED = "FF FF FE 06 82 38 02 01 02 3C"
    SECOND = "FF FF 02 04 00 FF 07 F3"

    def test_sdk_sync_read_loses_reply_after_silent_servo(self, stock, line):
        handler, port = stock
        group = scservo_sdk.GroupSyncRead(port, handler, 56, 2)
        group.addParam(1)
        group.addParam(2)
        line.expect(self.ASKED, self.SECOND)
        group.txRxPacket()
        assert group.isAvailable(2, 56, 2) is False

    def test_driver_sync_read_keeps_reply_after_silent_servo(self, feetech, line):
        line.expect(self.ASKED, self.SECOND)
        readings = feetech.sync_read([1, 2], RegisterName.PRESENT_POSITION, raw=True)
        assert readings.values == {2: 2047}
        assert "shoulder_pan (id 1) on scripted does not answer" in str(readings.errors[1])

    def test_driver_sync_read_reports_alarms_and_values(self, feetech, line):
        line.expect(self.ASKED, "FF FF 01 04 20 00 08 D2", self.SECOND)
        readings = feetech.sync_read([1, 2], RegisterName.PRESENT_POSITION, raw=True)
        assert readings.alarms == {1: {Alarm.OVERLOAD}}
        assert readings.require_all() == {1: 2048, 2: 2047}


class TestF11FalseHeader:
    """Noise that looks like the header of a long packet hides the packet behind it."""

    NOISE = "FF FF 01 F0 00"

    def test_sdk_loses_reply_after_noise_like_long_packet(self, stock, line):
        handler, port = stock
        line.expect(READ_POSITION, self.NOISE + AT_2048)
        assert handler.read2ByteTxRx(port, 1, 56)[1] == COMM_RX_CORRUPT

    def test_driver_finds_reply_after_noise_like_long_packet(self, feetech, line):
        line.expect(READ_POSITION, self.NOISE + AT_2048)
        assert feetech.read(1, POSITION, raw=True) == 2048


class TestF12Echo:
    """On an adapter with echo, the request is mistaken for its reply."""

    def test_sdk_mistakes_echo_for_reply(self, stock, line):
        handler, port = stock
        line.expect(READ_POSITION, READ_POSITION, AT_2048)
        assert handler.read2ByteTxRx(port, 1, 56)[0] == 568

    def test_driver_skips_echo_of_its_request(self, feetech, line):
        line.expect(READ_POSITION, READ_POSITION, AT_2048)
        assert feetech.read(1, POSITION, raw=True) == 2048

    def test_echo_without_reply_raises_servo_silent_error(self, feetech, line):
        line.expect(READ_POSITION, READ_POSITION)
        with pytest.raises(ServoSilentError):
            feetech.read(1, POSITION)

    def test_ping_reply_with_voltage_alarm_is_not_taken_for_echo(self, feetech, line):
        line.expect(PING, PING)
        line.expect("FF FF 01 04 02 03 02 F3", "FF FF 01 04 01 09 03 ED")
        assert feetech.ping(1).model_number == 777

    def test_echoed_ping_counts_as_silence_once_echo_is_known(self, feetech, line):
        line.expect(READ_POSITION, READ_POSITION, AT_2048)
        line.expect("FF FF 02 02 01 FA", "FF FF 02 02 01 FA")
        feetech.read(1, POSITION)
        with pytest.raises(ServoSilentError):
            feetech.ping(2)


class TestF13ForeignLength:
    """A reply of the right servo to another request is accepted."""

    ONE_BYTE = "FF FF 01 03 00 20 DB"

    def test_sdk_mistakes_checksum_of_short_reply_for_data(self, stock, line):
        handler, port = stock
        line.expect(READ_POSITION, self.ONE_BYTE)
        assert handler.read2ByteTxRx(port, 1, 56)[1] == COMM_SUCCESS

    def test_driver_waits_for_reply_of_right_length(self, feetech, line):
        line.expect(READ_POSITION, self.ONE_BYTE + AT_2048)
        assert feetech.read(1, POSITION, raw=True) == 2048


class TestF14Ping:
    """A ping is two requests, and fails if only the first is answered."""

    def test_sdk_ping_times_out_although_servo_replied(self, stock, line):
        handler, port = stock
        line.expect(PING, "FF FF 01 02 00 FC")
        line.expect("FF FF 01 04 02 03 02 F3")
        assert handler.ping(port, 1)[1] == COMM_RX_TIMEOUT

    def test_driver_ping_names_failed_model_read(self, feetech, line):
        line.expect(PING, "FF FF 01 02 00 FC")
        line.expect("FF FF 01 04 02 03 02 F3")
        with pytest.raises(ServoSilentError, match="read model_number"):
            feetech.ping(1)


class TestF16NoSyncRead:
    """SCS servos never answer a sync read."""

    def test_sdk_sync_read_times_out_if_servo_lacks_sync_read(self, stock, line):
        handler, port = stock
        group = scservo_sdk.GroupSyncRead(port, handler, 56, 2)
        group.addParam(1)
        line.expect("FF FF FE 05 82 38 02 01 3F")
        assert group.txRxPacket() == COMM_RX_TIMEOUT

    def test_driver_reads_one_by_one_without_sync_read(self, port, line):
        line.expect(READ_POSITION, AT_2048)
        replies = FeetechDriver(port, can_sync_read=False).sync_read([1], 56, 2)
        assert replies[1].data == bytes.fromhex("00 08")


class TestF17Threads:
    """Two threads on one port disturb each other."""

    def test_sdk_refuses_second_thread_as_busy(self, stock, line):
        handler, port = stock
        port.is_using = True  # the first thread is between question and answer
        assert handler.read2ByteTxRx(port, 1, 56)[1] == COMM_PORT_BUSY

    def test_driver_makes_second_thread_wait(self, feetech, line, port):
        line.expect(READ_POSITION, AT_2048)
        found = []
        second = threading.Thread(target=lambda: found.append(feetech.read(1, POSITION, raw=True)))
        with port.exchange():
            second.start()
            assert not line.sent
        second.join()
        assert found == [2048]


class TestF18HighErrorBits:
    """A reply with bit 7 set in its error byte is dropped."""

    ODD = "FF FF 01 04 80 00 08 72"

    def test_sdk_drops_reply_with_unknown_alarm_bit(self, stock, line):
        handler, port = stock
        line.expect(READ_POSITION, self.ODD)
        assert handler.read2ByteTxRx(port, 1, 56)[1] != COMM_SUCCESS

    def test_driver_keeps_value_and_unknown_alarm(self, feetech, line):
        line.expect(READ_POSITION, self.ODD)
        assert feetech.read(1, POSITION, raw=True) == 2048
        assert feetech.alarms[1] == {Alarm.UNKNOWN}


def test_reply_with_wrong_checksum_is_a_bad_reply_error(feetech, line):
    line.expect(READ_POSITION, "FF FF 01 04 00 01 08 F2")
    with pytest.raises(BadReplyError, match="damaged reply"):
        feetech.read(1, POSITION)


def test_two_different_replies_of_one_id_are_a_bad_reply_error(feetech, line):
    line.expect("FF FF FE 06 82 38 02 01 02 3C", AT_2048, AT_5, after_s=0.0005)
    readings = feetech.sync_read([1, 2], RegisterName.PRESENT_POSITION, raw=True)
    assert readings.values == {}
    assert isinstance(readings.errors[1], BadReplyError)


def test_voltage_is_read_from_register_of_servo_model(port, line):
    bus = ServoBus(port, [ServoSpec(1, STS3215, "elbow")])
    line.expect("FF FF 01 04 02 3E 01 B9", "FF FF 01 03 00 7B 80")
    assert bus.read(1, RegisterName.PRESENT_VOLTAGE) == pytest.approx(12.3)
