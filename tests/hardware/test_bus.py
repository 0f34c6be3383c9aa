"""The bus: refused requests, retries, and errors if a servo does not answer."""

from __future__ import annotations

import math

import pytest

from ikservo.errors import (
    BadValueError,
    BusError,
    RegisterAccessError,
    ServoRejectedError,
    ServoSilentError,
    UnknownNameError,
)
from ikservo.hardware import ServoBus, ServoSpec
from ikservo.registers import STS3215, XL330M288, XL430W250, Alarm, RegisterName

from .packets import reply, request, sync_request

READ_1 = "FF FF 01 04 02 38 02 BE"
AT_2048 = "FF FF 01 04 00 00 08 F2"
TAKEN = "FF FF 01 02 00 FC"


@pytest.fixture
def patient(port):
    """Return a bus with two retries."""
    return ServoBus(port, [ServoSpec(1, STS3215, "elbow_flex")], retries=2)


class TestRefusedBeforeAByteIsSent:
    """A refused request sends nothing: the scripted line fails a test at an unexpected byte."""

    def test_write_to_read_only_register_is_refused(self, feetech):
        with pytest.raises(
            RegisterAccessError, match=r"present_position of shoulder_pan .* read-only"
        ):
            feetech.write(1, STS3215.present_position, 0, raw=True)

    @pytest.mark.parametrize("tick", [-32768, 32768, 1 << 40])
    def test_write_of_tick_outside_register_range_is_refused(self, feetech, tick):
        with pytest.raises(RegisterAccessError, match="outside -32767 to 32767"):
            feetech.write(1, STS3215.goal_position, tick, raw=True)

    @pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
    def test_write_of_nan_or_infinity_is_refused(self, feetech, value):
        with pytest.raises(RegisterAccessError, match="not a number"):
            feetech.write(1, STS3215.goal_position, value)

    def test_write_of_fractional_tick_is_refused(self, feetech):
        with pytest.raises(BadValueError, match="an integer"):
            feetech.write(1, STS3215.goal_position, 2048.5, raw=True)

    def test_sync_write_with_one_invalid_goal_sends_nothing(self, feetech):
        with pytest.raises(RegisterAccessError, match="shoulder_lift"):
            feetech.sync_write(RegisterName.GOAL_POSITION, {1: 2048, 2: 99_999}, raw=True)

    def test_read_of_unknown_id_is_refused_with_known_ids(self, feetech):
        with pytest.raises(BadValueError, match=r"id is 9.*\n.*shoulder_pan \(id 1\)"):
            feetech.read(9, RegisterName.PRESENT_POSITION)

    def test_write_to_register_of_another_family_is_refused(self, feetech):
        with pytest.raises(UnknownNameError, match="STS3215 register named 'goal_current'"):
            feetech.write(1, XL330M288.goal_current, 0)

    def test_eeprom_write_is_refused_while_torque_is_on(self, feetech, line):
        line.expect("FF FF 01 04 03 28 01 CE", TAKEN)
        feetech.write(1, STS3215.torque_enable, 1)
        with pytest.raises(RegisterAccessError, match="torque is on"):
            feetech.write(1, STS3215.homing_offset, 0)

    def test_sync_write_without_goals_sends_nothing(self, feetech):
        feetech.sync_write(RegisterName.GOAL_POSITION, {})

    def test_sync_read_without_servos_sends_nothing(self, feetech):
        assert feetech.sync_read([], RegisterName.PRESENT_POSITION).require_all() == {}


def test_torque_state_read_by_sync_read_is_remembered(feetech, line):
    line.expect("FF FF FE 05 82 28 01 01 50", "FF FF 01 03 00 01 FA")
    feetech.sync_read([1], RegisterName.TORQUE_ENABLE)
    with pytest.raises(RegisterAccessError, match="torque is on"):
        feetech.write(1, STS3215.homing_offset, 0)


AGAIN_1 = request(1, 55, 3)  # a window one byte wider: a late answer to READ_1 is two bytes long
AGAIN_AT_2048 = reply(1, 0, 0, 8)
THIRD_1 = request(1, 54, 4)


class TestRepeats:
    """Repeatable requests are retried, a limited number of times, each in another form."""

    def test_lost_reply_is_retried(self, patient, line):
        line.expect(READ_1).expect(AGAIN_1).expect(THIRD_1, reply(1, 0, 0, 0, 8))
        assert patient.read(1, RegisterName.PRESENT_POSITION, raw=True) == 2048

    def test_damaged_reply_is_retried(self, patient, line):
        line.expect(READ_1, "FF FF 01 04 00 01 08 F2").expect(AGAIN_1, AGAIN_AT_2048)
        assert patient.read(1, RegisterName.PRESENT_POSITION, raw=True) == 2048

    def test_three_lost_replies_raise_servo_silent_error(self, patient, line):
        line.expect(READ_1).expect(AGAIN_1).expect(THIRD_1)
        with pytest.raises(ServoSilentError):
            patient.read(1, RegisterName.PRESENT_POSITION)

    def test_rejected_read_is_not_retried(self, patient, line):
        line.expect(READ_1, "FF FF 01 02 20 DC")
        with pytest.raises(ServoRejectedError):
            patient.read(1, RegisterName.PRESENT_POSITION)

    def test_registered_write_is_not_retried(self, patient, line):
        line.expect("FF FF 01 04 03 28 01 CE", TAKEN).expect("FF FF 01 05 04 2A 00 08 C3")
        patient.write(1, STS3215.torque_enable, 1)
        with pytest.raises(ServoSilentError):
            patient.reg_write(1, STS3215.goal_position, 2048, raw=True)

    def test_middle_position_write_is_not_retried(self, patient, line):
        line.expect("FF FF 01 04 03 28 80 4F")
        with pytest.raises(ServoSilentError):
            patient.write(1, STS3215.torque_enable, 128)

    def test_sync_read_retries_only_silent_servos(self, port, line):
        bus = ServoBus(port, [ServoSpec(1, STS3215), ServoSpec(2, STS3215)])
        line.expect("FF FF FE 06 82 38 02 01 02 3C", AT_2048)
        line.expect(sync_request([2], 55, 3), reply(2, 0, 0xFF, 7))
        assert bus.sync_read([1, 2], RegisterName.PRESENT_POSITION, raw=True).require_all() == {
            1: 2048,
            2: 2047,
        }


class TestUnresponsiveServos:
    """A servo that did not answer three requests is asked only every quarter of a second."""

    @pytest.fixture
    def unresponsive_bus(self, patient, line):
        for address, size in ((56, 2), (55, 3), (54, 4)):
            line.expect(sync_request([1], address, size))
        for _ in range(2):
            patient.sync_read([1], RegisterName.PRESENT_POSITION)
        return patient

    def test_sync_read_skips_unresponsive_servo_without_delay(self, unresponsive_bus, line):
        before_s = line.clock.now_s()
        assert isinstance(
            unresponsive_bus.sync_read([1], RegisterName.PRESENT_POSITION).errors[1],
            ServoSilentError,
        )
        assert line.clock.now_s() == before_s

    def test_unresponsive_servo_is_polled_again_after_300_ms(self, unresponsive_bus, line):
        line.clock.s += 0.3
        line.expect(sync_request([1], 56, 2))
        assert unresponsive_bus.sync_read([1], RegisterName.PRESENT_POSITION).errors.keys() == {1}

    def test_servo_that_answers_again_is_read_normally(self, unresponsive_bus, line):
        line.clock.s += 0.3
        for _ in range(2):
            line.expect(sync_request([1], 56, 2), AT_2048)
            assert unresponsive_bus.sync_read(
                [1], RegisterName.PRESENT_POSITION, raw=True
            ).require_all() == {1: 2048}


class TestStatistics:
    """Every request is counted."""

    def test_bus_statistics_count_losses_and_retries(self, patient, line):
        line.expect(READ_1).expect(AGAIN_1, "00").expect(THIRD_1, reply(1, 0, 0, 0, 8))
        patient.read(1, RegisterName.PRESENT_POSITION)
        counts = patient.statistics[1]
        assert (counts.requests, counts.lost, counts.garbled, counts.retried) == (3, 1, 1, 2)

    def test_round_trip_time_is_time_until_reply(self, patient, line):
        line.expect(READ_1, AT_2048, after_s=0.0007)
        patient.read(1, RegisterName.PRESENT_POSITION)
        assert patient.statistics[1].round_trip_s(0.5) == pytest.approx(0.0007)

    def test_round_trip_time_is_none_without_reply(self, patient):
        assert patient.statistics[1].round_trip_s(0.5) is None


class TestErrors:
    """Errors name the joint, the id, the port, the request and a remedy."""

    def test_silent_servo_error_names_register_and_sent_bytes(self, feetech, line):
        line.expect(READ_1)
        with pytest.raises(ServoSilentError) as caught:
            feetech.read(1, RegisterName.PRESENT_POSITION)
        assert str(caught.value) == (
            "shoulder_pan (id 1) on scripted does not answer when asked to read present_position.\n"
            "Check its power, the cable that leads to it, its id and the baud rate.\n"
            "Sent FF FF 01 04 02 38 02 BE, received nothing."
        )

    def test_bus_error_keeps_bytes_for_bug_report(self, feetech, line):
        line.expect(READ_1, "FF FF 01 04 00 01 08 F2")
        with pytest.raises(BusError) as caught:
            feetech.read(1, RegisterName.PRESENT_POSITION)
        assert caught.value.sent == bytes.fromhex(READ_1)
        assert caught.value.received == bytes.fromhex("FF FF 01 04 00 01 08 F2")

    def test_silent_servo_error_suggests_unplugged_cable(self, port, line):
        names = ["pan", "lift", "elbow"]
        bus = ServoBus(port, [ServoSpec(i, STS3215, n) for i, n in enumerate(names, 1)], retries=0)
        line.expect("FF FF FE 07 82 38 02 01 02 03 38", AT_2048)
        readings = bus.sync_read([1, 2, 3], RegisterName.PRESENT_POSITION)
        with pytest.raises(
            ServoSilentError,
            match=r"lift \(id 2\), elbow \(id 3\)(.|\n)*; 1 answers. .* from pan to lift",
        ):
            readings.require_all()

    def test_silence_of_all_servos_suggests_power_or_baud_rate(self, feetech, line):
        line.expect("FF FF FE 06 82 38 02 01 02 3C")
        with pytest.raises(ServoSilentError, match=r"Check the power supply .* all baud rates"):
            feetech.sync_read([1, 2], RegisterName.PRESENT_POSITION).require_all()


def test_servo_models_of_one_family_share_one_sync_read(port, line):
    bus = ServoBus(port, [ServoSpec(1, XL430W250), ServoSpec(2, XL330M288)], fast=False)
    line.expect(
        "FF FF FD 00 FE 09 00 82 84 00 04 00 01 02 CE FA",
        "FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0",
        "FF FF FD 00 02 08 00 55 00 1F 08 00 00 BA BE",
    )
    assert bus.sync_read([1, 2], RegisterName.PRESENT_POSITION, raw=True).require_all() == {
        1: 166,
        2: 2079,
    }


def test_families_on_one_bus_are_read_in_their_own_protocols(port, line):
    bus = ServoBus(port, [ServoSpec(1, XL430W250), ServoSpec(2, STS3215)])
    line.expect(
        "FF FF FD 00 FE 08 00 82 84 00 04 00 01 FE CF",
        "FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0",
    )
    line.expect("FF FF FE 05 82 38 02 02 3E", "FF FF 02 04 00 FF 07 F3")
    assert bus.sync_read([1, 2], RegisterName.PRESENT_POSITION, raw=True).require_all() == {
        1: 166,
        2: 2047,
    }


def test_alarm_register_is_decoded_to_named_alarms(feetech, line):
    line.expect("FF FF 01 04 02 41 01 B6", "FF FF 01 03 20 25 B6")
    assert feetech.read_alarms(1) == {Alarm.VOLTAGE, Alarm.HEAT, Alarm.OVERLOAD}


def test_closing_bus_closes_port(feetech, line):
    with feetech:
        pass
    assert not line.is_open


class TestReturnDelays:
    """Return delays are read once, so that a silent servo costs no more time than necessary."""

    ASKED = "FF FF FE 06 82 07 01 01 02 6E"

    def test_longest_return_delay_of_family_sets_time_out(self, feetech, line):
        line.expect(self.ASKED, "FF FF 01 03 00 00 FB", "FF FF 02 03 00 32 C8")
        line.expect(READ_1)
        feetech.load_return_delays()
        asked_s = line.clock.now_s()
        with pytest.raises(ServoSilentError):
            feetech.read(1, RegisterName.PRESENT_POSITION)
        wire_s = feetech.port.wire_s(8 + 8)
        assert line.clock.now_s() - asked_s == pytest.approx(wire_s + 50 * 2e-6 + 0.001, abs=0.0002)

    def test_unknown_return_delay_uses_longest_time_out(self, feetech, line):
        line.expect(self.ASKED, "FF FF 01 03 00 00 FB")
        line.expect("FF FF FE 06 82 38 02 01 02 3C", "FF FF 02 04 00 FF 07 F3", after_s=0.0021)
        feetech.load_return_delays()
        assert feetech.sync_read([1, 2], RegisterName.PRESENT_POSITION, raw=True).values == {
            2: 2047
        }
