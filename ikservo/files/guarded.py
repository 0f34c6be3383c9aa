"""Texts that carry a checksum of themselves, so that no spoiled one is ever believed.

The first line is ``checksum = "sha256:…"`` over everything after it: a file that was cut short,
mixed with another or changed by hand is refused before any of its values is looked at.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

from ikservo.errors import FileFormatError

__all__ = ["guarded", "with_checksum"]

_CHECKSUM = 'checksum = "sha256:'


def with_checksum(body: str) -> str:
    """Return a body with the line before it that guards it."""
    return f"{_first_line(body)}\n{body}"


def guarded(path: Path, text: str) -> str:
    """Return what stands below the checksum, if it is what the checksum was made of.

    Raises:
        FileFormatError: There is not a checksum, or it is not this text's.
    """
    first, _, body = text.replace("\r\n", "\n").partition("\n")
    if not first.startswith(_CHECKSUM):
        expected = "a file that ikservo has written"
        raise FileFormatError(path, "line 1", "is not a checksum", expected)
    if first != _first_line(body):
        expected = "the file as ikservo wrote it; the previous one may be beside it as .bak"
        raise FileFormatError(path, "", "was cut short or changed after it was written", expected)
    return body


def _first_line(body: str) -> str:
    return f'{_CHECKSUM}{hashlib.sha256(body.encode("utf-8", "surrogatepass")).hexdigest()}"'
