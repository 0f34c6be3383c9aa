"""On any line, a value is right or it is not reported."""

from __future__ import annotations

import dynamixel_sdk
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from ikservo.hardware.packets import StatusPacket
from ikservo.hardware.protocols import protocol1
from ikservo.hardware.protocols.protocol2 import Protocol2Codec, crc, stuff

noise = st.lists(st.sampled_from([0xFF, 0xFD, 0x00, 0x01, 0x02, 0x04, 0x55, 0x7A]), max_size=12)
data = st.binary(min_size=2, max_size=2)
ids = st.integers(0, 252)
TWO = Protocol2Codec(too_long=-2000)


def packet_1(servo_id: int, error: int, parameters: bytes) -> bytes:
    body = bytes((servo_id, len(parameters) + 2, error, *parameters))
    return b"\xff\xff" + body + bytes(((255 - sum(body) % 256),))


def packet_2(servo_id: int, error: int, parameters: bytes) -> bytes:
    inside = stuff(bytes((0x55, error, *parameters)))
    packet = bytes((0xFF, 0xFF, 0xFD, 0, servo_id, *(len(inside) + 2).to_bytes(2, "little")))
    return packet + inside + crc_16(packet + inside).to_bytes(2, "little")


def crc_16(packet: bytes) -> int:
    """Return CRC-16/BUYPASS bit by bit: polynomial 0x8005, from 0, highest bit first."""
    value = 0
    for byte in packet:
        value ^= byte << 8
        for _ in range(8):
            value = (value << 1 ^ 0x8005) & 0xFFFF if value & 0x8000 else value << 1
    return value


PROTOCOLS = {"1": (packet_1, protocol1.scan_packets), "2": (packet_2, TWO.scan)}
both = pytest.mark.parametrize(("packet", "scan"), PROTOCOLS.values(), ids=PROTOCOLS)


@both
@given(servo_id=ids, error=st.integers(0, 255), parameters=data)
def test_packet_is_decoded_as_it_was_encoded(packet, scan, servo_id, error, parameters):
    received = scan(packet(servo_id, error, parameters), (2,), final=True)
    assert received.frames == (StatusPacket(servo_id, error, parameters),)


@both
@given(before=noise, servo_id=ids, parameters=data)
def test_noise_before_packet_does_not_hide_packet(packet, scan, before, servo_id, parameters):
    received = bytes(before) + packet(servo_id, 0, parameters)
    assume(not scan(received[:-1], (2,), final=True).frames)  # such noise is a packet by itself
    assert scan(received, (2,), final=True).frames == (StatusPacket(servo_id, 0, parameters),)


@both
@given(servo_id=ids, parameters=data, cut=st.integers(min_value=1))
def test_incomplete_packet_stays_in_receive_buffer(packet, scan, servo_id, parameters, cut):
    whole = packet(servo_id, 0, parameters)
    beginning = whole[: 1 + cut % (len(whole) - 1)]
    received = scan(beginning, (2,), final=False)
    assert (received.frames, received.pending) == ((), len(beginning))


@both
@given(servo_id=ids, parameters=data, where=st.integers(0, 200), bit=st.integers(0, 7))
def test_packet_with_flipped_bit_never_yields_other_data(
    packet, scan, servo_id, parameters, where, bit
):
    damaged = bytearray(packet(servo_id, 0, parameters))
    damaged[where % len(damaged)] ^= 1 << bit
    received = scan(bytes(damaged), (2,), final=True)
    assert all(len(frame.data) != 2 for frame in received.frames)


@both
@given(anything=st.binary(max_size=64), final=st.booleans())
def test_packet_scanner_survives_random_bytes(packet, scan, anything, final):
    received = scan(anything, (2,), final=final)
    assert 0 <= received.pending <= len(anything)


@given(st.binary(max_size=40))
def test_crc_equals_crc_of_data_sheet_and_sdk(packet):
    assert crc(0, packet, len(packet)) == crc_16(packet)
    assert dynamixel_sdk.PacketHandler(2.0).updateCRC(0, packet, len(packet)) == crc_16(packet)
