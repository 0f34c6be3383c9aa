"""Encoding of signed numbers in words."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ikservo.registers import STS3215, XL430W250, SignMagnitude, TwosComplement, Unsigned

ALL = [Unsigned(), TwosComplement(), SignMagnitude(10), SignMagnitude(11), SignMagnitude(15)]


@pytest.mark.parametrize(
    ("register", "raw", "data"),
    [
        (STS3215.goal_position, 2048, "00 08"),
        (STS3215.goal_position, -1, "01 80"),
        (STS3215.homing_offset, -100, "64 08"),
        (STS3215.present_load, -1000, "E8 07"),
        (STS3215.model_number, 777, "09 03"),
        (XL430W250.goal_position, -1, "FF FF FF FF"),
        (XL430W250.goal_pwm, -885, "8B FC"),
        (XL430W250.bus_watchdog, -1, "FF"),
        (XL430W250.present_position, 166, "A6 00 00 00"),
    ],
)
class TestBytes:
    """Examples of the data sheets, in both directions."""

    def test_register_encodes_value_to_bytes(self, register, raw, data):
        assert register.encode(raw) == bytes.fromhex(data)

    def test_register_decodes_bytes_to_value(self, register, raw, data):
        assert register.decode(bytes.fromhex(data)) == raw


@pytest.mark.parametrize("codec", ALL, ids=str)
@given(data=st.data())
def test_register_codec_round_trips_every_number(codec, data):
    size = 2
    number = data.draw(st.integers(*codec.span(size)))
    assert codec.to_number(codec.to_word(number, size), size) == number


@pytest.mark.parametrize("codec", ALL, ids=str)
@given(data=st.data())
def test_register_codec_output_fits_register_size(codec, data):
    size = 2
    assert 0 <= codec.to_word(data.draw(st.integers(*codec.span(size))), size) < 1 << 16


@pytest.mark.parametrize("codec", ALL, ids=str)
@given(word=st.integers(0, 0xFFFF))
def test_register_codec_decodes_every_word_into_range(codec, word):
    lower, upper = codec.span(2)
    assert lower <= codec.to_number(word, 2) <= upper


def test_sign_magnitude_minus_zero_decodes_to_zero():
    assert SignMagnitude(15).to_number(0x8000, 2) == 0
