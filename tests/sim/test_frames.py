"""Each golden vector of the protocol manuals, written and read."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from servosim.frames import (
    Dynamixel1Reader,
    Dynamixel2Reader,
    Frame,
    crc16,
    encode1,
    encode2,
    stuff,
    unstuff,
)

# fmt: off
PROTOCOL_2 = {
    "ping":                   (1, 0x01, "", "FFFFFD00 01 0300 01 194E"),
    "ping, answered":         (1, 0x55, "00 06 04 26", "FFFFFD00 01 0700 55 00 060426 655D"),
    "broadcast ping":         (254, 0x01, "", "FFFFFD00 FE 0300 01 3142"),
    "read position":          (1, 0x02, "84 00 04 00", "FFFFFD00 01 0700 02 84000400 1D15"),
    "position 166":           (1, 0x55, "00 A6 00 00 00", "FFFFFD00 01 0800 55 00 A6000000 8CC0"),
    "read hardware error":    (1, 0x02, "46 00 01 00", "FFFFFD00 01 0700 02 46000100 3CA3"),
    "alert, overload":        (1, 0x55, "80 20", "FFFFFD00 01 0500 55 80 20 9921"),
    "torque on":              (1, 0x03, "40 00 01", "FFFFFD00 01 0600 03 400001 DB66"),
    "torque off":             (1, 0x03, "40 00 00", "FFFFFD00 01 0600 03 400000 DEE6"),
    "write goal 512":         (1, 0x03, "74 00 00 02 00 00",
                               "FFFFFD00 01 0900 03 740000020000 CA89"),
    "done":                   (1, 0x55, "00", "FFFFFD00 01 0400 55 00 A10C"),
    "range error":            (1, 0x55, "04", "FFFFFD00 01 0400 55 04 BA8C"),
    "access error":           (1, 0x55, "07", "FFFFFD00 01 0400 55 07 B08C"),
    "registered write":       (1, 0x04, "68 00 C8 00 00 00",
                               "FFFFFD00 01 0900 04 6800C8000000 AE8E"),
    "action":                 (1, 0x05, "", "FFFFFD00 01 0300 05 02CE"),
    "factory reset":          (1, 0x06, "01", "FFFFFD00 01 0400 06 01 A1E6"),
    "reboot":                 (1, 0x08, "", "FFFFFD00 01 0300 08 2F4E"),
    "clear":                  (1, 0x10, "01 44 58 4C 22", "FFFFFD00 01 0800 10 0144584C22 B1DC"),
    "backup, store":          (1, 0x20, "01 43 54 52 4C", "FFFFFD00 01 0800 20 014354524C 16F5"),
    "backup, restore":        (1, 0x20, "02 43 54 52 4C", "FFFFFD00 01 0800 20 024354524C 9EF5"),
    "sync read":              (254, 0x82, "84 00 04 00 01 02",
                               "FFFFFD00 FE 0900 82 840004000102 CEFA"),
    "sync read, second":      (2, 0x55, "00 1F 08 00 00", "FFFFFD00 02 0800 55 00 1F080000 BABE"),
    "sync write":             (254, 0x83, "74 00 04 00 01 96 00 00 00 02 AA 00 00 00",
                               "FFFFFD00 FE 1100 83 74000400 0196000000 02AA000000 8287"),
    "sync write, arm":        (254, 0x83, "74 00 04 00 01 00 08 00 00 02 00 04 00 00",
                               "FFFFFD00 FE 1100 83 74000400 0100080000 0200040000 984C"),
    "bulk read":              (254, 0x92, "01 90 00 02 00 02 92 00 01 00",
                               "FFFFFD00 FE 0D00 92 0190000200 0292000100 1A05"),
    "fast bulk read":         (254, 0x9A, "01 90 00 02 00 02 92 00 01 00",
                               "FFFFFD00 FE 0D00 9A 0190000200 0292000100 192F"),
    "bulk write":             (254, 0x93, "01 20 00 02 00 A0 00 02 1F 00 01 00 50",
                               "FFFFFD00 FE 1000 93 0120000200A000 021F00010050 B768"),
    "fast sync read":         (254, 0x8A, "84 00 04 00 03 07 04",
                               "FFFFFD00 FE 0A00 8A 84000400030704 20F2"),
    "stuffed goal":           (1, 0x03, "74 00 FF FF FD 00",
                               "FFFFFD00 01 0A00 03 7400FFFFFDFD00 21E7"),
    "watchdog":               (1, 0x03, "62 00 05", "FFFFFD00 01 0600 03 620005 68E4"),
}

PROTOCOL_1 = {
    "ping":                   (1, 0x01, "", "FFFF 01 02 01 FB"),
    "ping, answered":         (1, 0x00, "", "FFFF 01 02 00 FC"),
    "read temperature":       (1, 0x02, "2B 01", "FFFF 01 04 02 2B01 CC"),
    "32 degrees":             (1, 0x00, "20", "FFFF 01 03 00 20 DB"),
    "errors 0x24":            (1, 0x24, "", "FFFF 01 02 24 D8"),
    "set id, broadcast":      (254, 0x03, "03 01", "FFFF FE 04 03 0301 F6"),
    "registered write":       (1, 0x04, "1E F4 01", "FFFF 01 05 04 1EF401 E2"),
    "action":                 (254, 0x05, "", "FFFF FE 02 05 FA"),
    "factory reset of id 0":  (0, 0x06, "", "FFFF 00 02 06 F7"),
    "sync write":             (254, 0x83, "1E 04 00 10 00 50 01 01 20 02 60 03",
                               "FFFF FE 0E 83 1E04 0010005001 0120026003 67"),
    "bulk read":              (254, 0x92, "00 02 01 1E 02 02 24",
                               "FFFF FE 09 92 00 02011E 020224 1D"),
    "read model":             (1, 0x02, "03 02", "FFFF 01 04 02 0302 F3"),
    "read position":          (1, 0x02, "38 02", "FFFF 01 04 02 3802 BE"),
    "position 2048":          (1, 0x00, "00 08", "FFFF 01 04 00 0008 F2"),
    "position, overload":     (1, 0x20, "00 08", "FFFF 01 04 20 0008 D2"),
    "torque on":              (1, 0x03, "28 01", "FFFF 01 04 03 2801 CE"),
    "here is the middle":     (1, 0x03, "28 80", "FFFF 01 04 03 2880 4F"),
    "goal 2048":              (1, 0x03, "2A 00 08", "FFFF 01 05 03 2A0008 C4"),
    "offset -100":            (1, 0x03, "1F 64 08", "FFFF 01 05 03 1F6408 6B"),
    "unlock":                 (1, 0x03, "37 00", "FFFF 01 04 03 3700 C0"),
    "registered goal":        (1, 0x04, "2A 00 08", "FFFF 01 05 04 2A0008 C3"),
    "sync write goals":       (254, 0x83, "2A 02 01 00 08 02 FF 07",
                               "FFFF FE 0A 83 2A02 010008 02FF07 37"),
    "sync read":              (254, 0x82, "38 02 01 02", "FFFF FE 06 82 3802 0102 3C"),
    "big-endian goal 512":    (1, 0x03, "2A 02 00", "FFFF 01 05 03 2A0200 CA"),
}
# fmt: on

FAST_REPLY = bytes.fromhex(
    "FFFFFD00FE190055 0003A60000008408 00071F08000016CA 0004FF030000D19E".replace(" ", "")
)


def _hex(text: str) -> bytes:
    return bytes.fromhex(text.replace(" ", ""))


@pytest.mark.parametrize("name", PROTOCOL_2)
def test_protocol_2_frame_is_encoded_and_read_as_in_manual(name):
    id_, instruction, params, raw = PROTOCOL_2[name]
    data = _hex(raw)
    assert encode2(id_, instruction, _hex(params)) == data
    assert Dynamixel2Reader().feed(data) == [Frame(id_, instruction, _hex(params), len(data))]


@pytest.mark.parametrize("name", PROTOCOL_1)
def test_protocol_1_frame_is_encoded_and_read_as_in_manual(name):
    id_, instruction, params, raw = PROTOCOL_1[name]
    data = _hex(raw)
    assert encode1(id_, instruction, _hex(params)) == data
    assert Dynamixel1Reader().feed(data) == [Frame(id_, instruction, _hex(params), len(data))]


def test_fast_sync_reply_part_has_crc_of_all_bytes_before():
    ends = (14, 22, 30)
    sums = [FAST_REPLY[end : end + 2] for end in ends]
    assert [crc16(FAST_REPLY[:end]).to_bytes(2, "little") for end in ends] == sums


@given(st.binary(max_size=40))
def test_unstuff_inverts_stuff(body):
    assert unstuff(stuff(body)) == body


@given(st.lists(st.sampled_from(b"\xff\xfd\x00\x01"), max_size=40))
def test_stuffed_bytes_do_not_contain_header(body):
    assert b"\xff\xff\xfd\x00" not in stuff(bytes(body))


@pytest.mark.parametrize(
    ("reader", "encode"), [(Dynamixel2Reader, encode2), (Dynamixel1Reader, encode1)]
)
class TestReader:
    def test_frame_reader_finds_frame_received_byte_by_byte(self, reader, encode):
        data, ears = encode(3, 2, b"\x84\x00\x04\x00"), reader()
        found = [frame for k in range(len(data)) for frame in ears.feed(data[k : k + 1])]
        assert found == [Frame(3, 2, b"\x84\x00\x04\x00", 1)]

    def test_frame_reader_finds_two_frames_in_one_chunk(self, reader, encode):
        first, second = encode(3, 1), encode(4, 1)
        found = reader().feed(first + second)
        assert [(frame.id, frame.end) for frame in found] == [(3, len(first)), (4, 2 * len(first))]

    def test_frame_reader_counts_junk_before_header(self, reader, encode):
        ears = reader()
        ears.feed(b"\x00\xff\x12" + encode(3, 1))
        assert ears.junk_bytes == 3

    def test_frame_reader_finds_frame_after_one_with_bad_checksum(self, reader, encode):
        bad = bytearray(encode(3, 1))
        bad[-1] ^= 1
        ears = reader()
        assert [frame.id for frame in ears.feed(bytes(bad) + encode(4, 1))] == [4]

    def test_frame_reader_counts_bad_checksums(self, reader, encode):
        bad = bytearray(encode(3, 1))
        bad[-1] ^= 1
        ears = reader()
        ears.feed(bytes(bad) + encode(4, 1))
        assert ears.bad_checksums == 1

    def test_frame_reader_finds_frame_after_truncated_one(self, reader, encode):
        torn = encode(3, 3, bytes(20))[:12]
        ears = reader()
        found = ears.feed(torn + encode(4, 1) + encode(5, 1) + encode(6, 1) + encode(7, 1))
        assert found[-1].id == 7

    def test_frame_reader_drops_unfinished_frame_at_reset(self, reader, encode):
        ears = reader()
        ears.feed(encode(3, 3, bytes(20))[:12])
        ears.reset()
        assert [frame.id for frame in ears.feed(encode(4, 1))] == [4]

    @given(noise=st.binary(max_size=60), cut=st.integers(0, 60))
    def test_frame_reader_reads_frame_after_noise_and_reset(self, reader, encode, noise, cut):
        ears = reader()
        ears.feed(noise[:cut])
        ears.feed(noise[cut:])
        ears.reset()
        assert [frame.id for frame in ears.feed(encode(9, 1))] == [9]
