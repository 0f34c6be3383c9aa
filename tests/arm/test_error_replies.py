"""Errors of an arm in another process keep their text and attributes in JSON."""

import json

import pytest

from ikservo.errors import BadReplyError, IkservoError, UnreachableError
from ikservo.serving.replies import error_fields, error_of

ERRORS = {
    "bus": BadReplyError("sent a damaged reply", servo="pan (id 1)", sent=b"\xff\x01",
                         received=b"\x00"),
    "reach": UnreachableError((9.0, 9.0, 9.0), (0.3, 0.0, 0.1), ()),
}  # fmt: skip


@pytest.mark.parametrize("name", ERRORS)
def test_error_received_from_other_process_has_same_text(name):
    error = ERRORS[name]
    received = error_of(json.loads(json.dumps(error_fields(error))))
    assert (type(received), str(received)) == (type(error), str(error))


def test_packet_bytes_in_error_survive_json():
    received = error_of(json.loads(json.dumps(error_fields(ERRORS["bus"]))))
    assert received.received == b"\x00"


@pytest.mark.parametrize("value", [3, None, [1], {"bytes": "zz"}, {"a": 1}])
def test_received_error_with_malformed_details_can_be_printed(value):
    fields = error_fields(ERRORS["bus"])
    fields["details"] |= {"sent": value, "received": value}
    received = error_of(fields)
    assert isinstance(received, IkservoError)
    assert str(received)
