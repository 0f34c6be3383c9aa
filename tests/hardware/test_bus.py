"""The bus: what it refuses to send, how often it asks, what it says when nobody answers."""

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
    """Give a bus that asks twice more."""
    return ServoBus(port, [ServoSpec(1, STS3215, "elbow_flex")], retries=2)


class TestRefusedBeforeAByteIsSent:
    """The scripted line fails a test at the first byte that it does not expect."""

    def test_a_read_only_register(self, feetech):
        with pytest.raises(
            RegisterAccessError, match=r"present_position of shoulder_pan .* read-only"
        ):
            feetech.write(1, STS3215.present_position, 0, raw=True)

    @pytest.mark.parametrize("tick", [-32768, 32768, 1 << 40])
    def test_a_number_outside_the_range(self, feetech, tick):
        with pytest.raises(RegisterAccessError, match="outside -32767 to 32767"):
            feetech.write(1, STS3215.goal_position, tick, raw=True)

    @pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
    def test_what_is_not_a_number(self, feetech, value):
        with pytest.raises(RegisterAccessError, match="not a number"):
            feetech.write(1, STS3215.goal_position, value)

    def test_a_fraction_of_a_tick(self, feetech):
        with pytest.raises(BadValueError, match="an integer"):
            feetech.write(1, STS3215.goal_position, 2048.5, raw=True)

    def test_a_goal_for_one_servo_that_does_not_fit_stops_the_goals_of_all(self, feetech):
        with pytest.raises(RegisterAccessError, match="shoulder_lift"):
            feetech.sync_write(RegisterName.GOAL_POSITION, {1: 2048, 2: 99_999}, raw=True)

    def test_an_unknown_id(self, feetech):
        with pytest.raises(BadValueError, match=r"id is 9.*\n.*shoulder_pan \(id 1\)"):
            feetech.read(9, RegisterName.PRESENT_POSITION)

    def test_a_register_of_another_family(self, feetech):
        with pytest.raises(UnknownNameError, match="STS3215 register named 'goal_current'"):
            feetech.write(1, XL330M288.goal_current, 0)

    def test_eeprom_while_torque_is_known_to_be_on(self, feetech, line):
        line.expect("FF FF 01 04 03 28 01 CE", TAKEN)
        feetech.write(1, STS3215.torque_enable, 1)
        with pytest.raises(RegisterAccessError, match="torque is on"):
            feetech.write(1, STS3215.homing_offset, 0)

    def test_nothing_to_write_is_nothing_sent(self, feetech):
        feetech.sync_write(RegisterName.GOAL_POSITION, {})

    def test_nobody_to_ask_is_nothing_sent(self, feetech):
        assert feetech.sync_read([], RegisterName.PRESENT_POSITION).require_all() == {}


def test_torque_that_a_group_reports_is_known_afterwards(feetech, line):
    line.expect("FF FF FE 05 82 28 01 01 50", "FF FF 01 03 00 01 FA")
    feetech.sync_read([1], RegisterName.TORQUE_ENABLE)
    with pytest.raises(RegisterAccessError, match="torque is on"):
        feetech.write(1, STS3215.homing_offset, 0)


AGAIN_1 = request(1, 55, 3)  # a window one byte wider: a late answer to READ_1 is two bytes long
AGAIN_AT_2048 = reply(1, 0, 0, 8)
THIRD_1 = request(1, 54, 4)


class TestRepeats:
    """Questions that may be repeated are, only so often, and each time in another shape."""

    def test_a_lost_answer_is_asked_for_again(self, patient, line):
        line.expect(READ_1).expect(AGAIN_1).expect(THIRD_1, reply(1, 0, 0, 0, 8))
        assert patient.read(1, RegisterName.PRESENT_POSITION, raw=True) == 2048

    def test_a_damaged_answer_is_asked_for_again(self, patient, line):
        line.expect(READ_1, "FF FF 01 04 00 01 08 F2").expect(AGAIN_1, AGAIN_AT_2048)
        assert patient.read(1, RegisterName.PRESENT_POSITION, raw=True) == 2048

    def test_three_losses_are_silence(self, patient, line):
        line.expect(READ_1).expect(AGAIN_1).expect(THIRD_1)
        with pytest.raises(ServoSilentError):
            patient.read(1, RegisterName.PRESENT_POSITION)

    def test_a_refusal_is_not_repeated(self, patient, line):
        line.expect(READ_1, "FF FF 01 02 20 DC")
        with pytest.raises(ServoRejectedError):
            patient.read(1, RegisterName.PRESENT_POSITION)

    def test_a_registered_write_is_not_repeated(self, patient, line):
        line.expect("FF FF 01 04 03 28 01 CE", TAKEN).expect("FF FF 01 05 04 2A 00 08 C3")
        patient.write(1, STS3215.torque_enable, 1)
        with pytest.raises(ServoSilentError):
            patient.reg_write(1, STS3215.goal_position, 2048, raw=True)

    def test_taking_a_place_as_the_middle_is_not_repeated(self, patient, line):
        line.expect("FF FF 01 04 03 28 80 4F")
        with pytest.raises(ServoSilentError):
            patient.write(1, STS3215.torque_enable, 128)

    def test_a_group_is_asked_again_for_those_who_were_silent(self, port, line):
        bus = ServoBus(port, [ServoSpec(1, STS3215), ServoSpec(2, STS3215)])
        line.expect("FF FF FE 06 82 38 02 01 02 3C", AT_2048)
        line.expect(sync_request([2], 55, 3), reply(2, 0, 0xFF, 7))
        assert bus.sync_read([1, 2], RegisterName.PRESENT_POSITION, raw=True).require_all() == {
            1: 2048,
            2: 2047,
        }


class TestUnresponsiveServos:
    """A servo that has been silent for three questions is asked only every quarter of a second."""

    @pytest.fixture
    def unresponsive_bus(self, patient, line):
        for address, size in ((56, 2), (55, 3), (54, 4)):
            line.expect(sync_request([1], address, size))
        for _ in range(2):
            patient.sync_read([1], RegisterName.PRESENT_POSITION)
        return patient

    def test_until_then_it_costs_nothing(self, unresponsive_bus, line):
        before_s = line.clock.now_s()
        assert isinstance(
            unresponsive_bus.sync_read([1], RegisterName.PRESENT_POSITION).errors[1],
            ServoSilentError,
        )
        assert line.clock.now_s() == before_s

    def test_then_it_is_asked_once(self, unresponsive_bus, line):
        line.clock.s += 0.3
        line.expect(sync_request([1], 56, 2))
        assert unresponsive_bus.sync_read([1], RegisterName.PRESENT_POSITION).errors.keys() == {1}

    def test_when_it_answers_it_is_one_of_them_again(self, unresponsive_bus, line):
        line.clock.s += 0.3
        for _ in range(2):
            line.expect(sync_request([1], 56, 2), AT_2048)
            assert unresponsive_bus.sync_read(
                [1], RegisterName.PRESENT_POSITION, raw=True
            ).require_all() == {1: 2048}


class TestStatistics:
    """Every question is counted."""

    def test_losses_and_repeats(self, patient, line):
        line.expect(READ_1).expect(AGAIN_1, "00").expect(THIRD_1, reply(1, 0, 0, 0, 8))
        patient.read(1, RegisterName.PRESENT_POSITION)
        counts = patient.statistics[1]
        assert (counts.requests, counts.lost, counts.garbled, counts.retried) == (3, 1, 1, 2)

    def test_the_round_trip_is_the_time_of_an_answer(self, patient, line):
        line.expect(READ_1, AT_2048, after_s=0.0007)
        patient.read(1, RegisterName.PRESENT_POSITION)
        assert patient.statistics[1].round_trip_s(0.5) == pytest.approx(0.0007)

    def test_without_an_answer_there_is_no_round_trip(self, patient):
        assert patient.statistics[1].round_trip_s(0.5) is None


class TestErrors:
    """A person reads which joint, which id, which port, what was asked and what now."""

    def test_silence(self, feetech, line):
        line.expect(READ_1)
        with pytest.raises(ServoSilentError) as caught:
            feetech.read(1, RegisterName.PRESENT_POSITION)
        assert str(caught.value) == (
            "shoulder_pan (id 1) on scripted does not answer when asked to read present_position.\n"
            "Check its power, the cable that leads to it, its id and the baud rate.\n"
            "Sent FF FF 01 04 02 38 02 BE, received nothing."
        )

    def test_the_bytes_are_kept_for_a_bug_report(self, feetech, line):
        line.expect(READ_1, "FF FF 01 04 00 01 08 F2")
        with pytest.raises(BusError) as caught:
            feetech.read(1, RegisterName.PRESENT_POSITION)
        assert caught.value.sent == bytes.fromhex(READ_1)
        assert caught.value.received == bytes.fromhex("FF FF 01 04 00 01 08 F2")

    def test_a_cable_that_is_out_is_guessed_from_who_is_silent(self, port, line):
        names = ["pan", "lift", "elbow"]
        bus = ServoBus(port, [ServoSpec(i, STS3215, n) for i, n in enumerate(names, 1)], retries=0)
        line.expect("FF FF FE 07 82 38 02 01 02 03 38", AT_2048)
        readings = bus.sync_read([1, 2, 3], RegisterName.PRESENT_POSITION)
        with pytest.raises(
            ServoSilentError,
            match=r"lift \(id 2\), elbow \(id 3\)(.|\n)*, 1 answers: .* from pan to lift",
        ):
            readings.require_all()

    def test_if_no_servo_replies_it_is_power_or_rate(self, feetech, line):
        line.expect("FF FF FE 06 82 38 02 01 02 3C")
        with pytest.raises(ServoSilentError, match=r"Check the power supply .* every baud rate"):
            feetech.sync_read([1, 2], RegisterName.PRESENT_POSITION).require_all()


def test_models_of_one_family_share_a_question(port, line):
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


def test_families_on_one_line_are_asked_each_in_its_own_protocol(port, line):
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


def test_an_alarm_register_is_spelt_out(feetech, line):
    line.expect("FF FF 01 04 02 41 01 B6", "FF FF 01 03 20 25 B6")
    assert feetech.read_alarms(1) == {Alarm.VOLTAGE, Alarm.HEAT, Alarm.OVERLOAD}


def test_closing_the_bus_closes_the_line(feetech, line):
    with feetech:
        pass
    assert not line.is_open


class TestReturnDelays:
    """How long servos dawdle is asked once, so that a silent one costs no more than it must."""

    ASKED = "FF FF FE 06 82 07 01 01 02 6E"

    def test_the_longest_of_the_family_counts(self, feetech, line):
        line.expect(self.ASKED, "FF FF 01 03 00 00 FB", "FF FF 02 03 00 32 C8")
        line.expect(READ_1)
        feetech.load_return_delays()
        asked_s = line.clock.now_s()
        with pytest.raises(ServoSilentError):
            feetech.read(1, RegisterName.PRESENT_POSITION)
        wire_s = feetech.port.wire_s(8 + 8)
        assert line.clock.now_s() - asked_s == pytest.approx(wire_s + 50 * 2e-6 + 0.001, abs=0.0002)

    def test_where_one_does_not_tell_the_longest_possible_stays(self, feetech, line):
        line.expect(self.ASKED, "FF FF 01 03 00 00 FB")
        line.expect("FF FF FE 06 82 38 02 01 02 3C", "FF FF 02 04 00 FF 07 F3", after_s=0.0021)
        feetech.load_return_delays()
        assert feetech.sync_read([1, 2], RegisterName.PRESENT_POSITION, raw=True).values == {
            2: 2047
        }
