"""What may be asked of the owner of a bus, as one short line of JSON, and nothing else.

There is no pickle, no code and no name of a file in it: a word out of a fixed list, and the secret
of a place that has no permissions of its own. Whatever is not exactly that is refused unread.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, cast

from ikservo.errors import InputError
from ikservo.files.reading import parse_json

__all__ = [
    "LONGEST_ANSWER",
    "LONGEST_REQUEST",
    "Errand",
    "Request",
    "answer_line",
    "read_answer",
    "read_request",
    "request_line",
]

SCHEMA = "ikservo/owner/1"
LONGEST_REQUEST = 512  # bytes, the end of the line included
LONGEST_ANSWER = 65_536
_KEYS = {"schema", "do", "secret"}


class Errand(StrEnum):
    """What another process may have done."""

    STOP = "stop"
    WHERE = "where"
    RELAX = "relax"


@dataclass(frozen=True, slots=True)
class Request:
    """One errand.

    Attributes:
        do: What shall be done.
        secret: What only the owner's user can read, where a place needs one.
    """

    do: Errand
    secret: str = ""


def request_line(request: Request) -> bytes:
    """Return a request as it goes over the line."""
    return _line({"schema": SCHEMA, "do": request.do.value, "secret": request.secret})


def read_request(line: bytes) -> Request:
    """Return the request in a line.

    Raises:
        InputError: It is too long, no JSON, or anything but a request of this schema.
    """
    row = _read(line, LONGEST_REQUEST)
    if row.keys() != _KEYS or row["schema"] != SCHEMA:
        raise _strange(f"expected the keys {', '.join(sorted(_KEYS))} of {SCHEMA}")
    if row["do"] not in list(Errand) or not isinstance(row["secret"], str):
        raise _strange(f"it can be asked to {', '.join(Errand)}")
    return Request(Errand(row["do"]), row["secret"])


def answer_line(fields: Mapping[str, object]) -> bytes:
    """Return an answer as it goes over the line."""
    return _line({"schema": SCHEMA, **fields})


def read_answer(line: bytes) -> dict[str, Any]:
    """Return the fields of an answer.

    Raises:
        InputError: It is none of this schema.
    """
    row = _read(line, LONGEST_ANSWER)
    if row.pop("schema", None) != SCHEMA:
        raise _strange(f"expected an answer of {SCHEMA}")
    return row


def _line(row: Mapping[str, object]) -> bytes:
    return json.dumps(row, allow_nan=False, separators=(",", ":")).encode() + b"\n"


def _read(line: bytes, longest: int) -> dict[str, Any]:
    if len(line) > longest:
        raise _strange(f"at most {longest} bytes")
    if not line.endswith(b"\n"):
        raise _strange("the end of the line is missing")
    try:
        row = parse_json(line)
    except (ValueError, RecursionError):  # not UTF-8, no JSON, a number too long, nested too deep
        raise _strange("expected one line of JSON") from None
    if not isinstance(row, dict):
        raise _strange("expected an object")
    return cast("dict[str, Any]", row)


def _strange(why: str) -> InputError:
    return InputError(f"Not a valid message between ikservo programs: {why}.", "Nothing was done.")
