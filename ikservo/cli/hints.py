"""Hints that can be typed as they stand: the arm and port of the command are repeated in them."""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence

__all__ = ["addressed"]

_WITH_ARM = (
    "gripper|jog|joints|move|pose|record|recover|relax|replay|stop|teach|where"  # alphabetical
)
_LAST = re.compile(rf"\bikservo (?:{_WITH_ARM})\b(?:[^,;()`]*[^,;()`.\s])?$")


def addressed(hint: str, words: Sequence[str]) -> str:
    """Return a hint with --arm and --port as the person gave them, where it ends with a command."""
    given = {name: _value(name, words) for name in ("--arm", "--port")}
    if not _LAST.search(hint):
        return hint
    options = [f"{name} {shlex.quote(value)}" for name, value in given.items() if value]
    return " ".join([hint, *(option for option in options if option.split()[0] not in hint)])


def _value(name: str, words: Sequence[str]) -> str:
    """Return the value of an option, given as ``--arm x`` or ``--arm=x``; nothing without it."""
    for word, after in zip(words, [*words[1:], ""], strict=True):
        if word == name:
            return after
        if word.startswith(f"{name}="):
            return word.partition("=")[2]
    return ""
