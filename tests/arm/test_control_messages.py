"""Messages between ikservo's programs; everything else is ignored."""

import json
import random

import pytest

from ikservo.errors import InputError
from ikservo.serving.control_client import (
    MAX_REQUEST_BYTES,
    ControlCommand,
    Request,
    decode_reply,
    decode_request,
    encode_reply,
    encode_request,
)

GOOD = {"schema": "ikservo/owner/1", "do": "stop", "secret": ""}


def line(**changes):
    return json.dumps({**GOOD, **changes}).encode() + b"\n"


@pytest.mark.parametrize("errand", ControlCommand)
def test_control_request_survives_encoding_and_decoding(errand):
    assert decode_request(encode_request(Request(errand, "abc"))) == Request(errand, "abc")


def test_control_request_is_encoded_as_one_json_line():
    line = b'{"schema":"ikservo/owner/1","do":"stop","secret":""}\n'
    assert encode_request(Request(ControlCommand.STOP)) == line


@pytest.mark.parametrize(
    "wrong",
    [
        b"",
        b"\n",
        b"stop\n",
        line()[:-1],
        b"\xff\xfe\n",
        b"[]\n",
        b"null\n",
        b'"stop"\n',
        b"[" * 400 + b"\n",
        line(do="dance"),
        line(do=["stop"]),
        line(do={"stop": 1}),
        line(do=None),
        line(schema="ikservo/owner/2"),
        line(secret=7),
        line(goal=5000),
        b'{"schema":"ikservo/owner/1","do":"stop"}\n',
        b'{"schema":"ikservo/owner/1","do":"where","do":"stop","secret":""}\n',
        line(secret="x" * MAX_REQUEST_BYTES),
        line(secret=float("nan")),
        b"\x80\x04\x95\x0c\x00\x00\x00\x00\x00\x00\x00\x8c\x08builtins.\n",
    ],
)
def test_malformed_control_request_is_refused(wrong):
    with pytest.raises(InputError, match="Nothing was done"):
        decode_request(wrong)


def test_control_reply_survives_encoding_and_decoding():
    assert decode_reply(encode_reply({"tip_m": [0.1, 0.0, 0.2]})) == {"tip_m": [0.1, 0.0, 0.2]}


def test_control_reply_without_schema_is_refused():
    with pytest.raises(InputError):
        decode_reply(b'{"error": "x"}\n')


def fuzzed(chance):
    """Return a request with some bytes changed, cut, doubled or inserted."""
    data = bytearray(
        encode_request(Request(chance.choice(list(ControlCommand)), chance.randbytes(4).hex()))
    )
    for _ in range(chance.randrange(1, 6)):
        at = chance.randrange(len(data) + 1)
        match chance.randrange(4):
            case 0:
                data[at:at] = chance.randbytes(chance.randrange(4))
            case 1:
                del data[at : at + chance.randrange(8)]
            case 2:
                data[at:at] = data[chance.randrange(len(data) + 1) :][:16]
            case _:
                data[at : at + 1] = chance.choice([b'"', b"{", b"[", b"\n", b"\\", b"9", b"\x00"])
        data = data or bytearray(b"{")
    return bytes(data)


LONG = pytest.param(1_000_000, marks=[pytest.mark.campaign, pytest.mark.timeout(600)])


@pytest.mark.parametrize("frames", [10_000, LONG])
def test_fuzzed_control_request_is_decoded_exactly_or_refused(frames):
    chance = random.Random(7)
    for _ in range(frames):
        frame = fuzzed(chance)
        try:
            request = decode_request(frame)
        except InputError:
            continue
        assert json.loads(frame) == json.loads(encode_request(request)), frame
