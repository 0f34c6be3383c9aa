"""Hints that can be typed as they are: the arm and port of the command are repeated in them."""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence
from itertools import zip_longest

__all__ = ["COMMAND", "addressed"]

COMMAND = re.compile(r"\bikservo ([a-z]+)((?: (?!ikservo\b)[^\s,;()`]*[^\s,;()`.:?])*)")
"""A command in a sentence: its name, and its arguments up to punctuation."""

_ARM_AS_OPTION = frozenset(
    [
        "bench",
        "doctor",
        "export",
        "follow",
        "gripper",
        "import",
        "jog",
        "joints",
        "move",
        "pose",
        "record",
        "recover",
        "relax",
        "replay",
        "scan",
        "solve",
        "stop",
        "teach",
        "view",
        "where",
        "workspace",
    ]
)
_ARM_AS_WORD = {"calibrate": 0, "setup": 0, "calibration": 1}
"""At which place among the words of a command its arm stands."""
_NO_PORT = frozenset(("arms", "ports", "sim", "solve", "workspace"))


def addressed(hint: str, words: Sequence[str]) -> str:
    """Return a hint whose commands have the arm and port that a person gave.

    Args:
        hint: A sentence with commands in it.
        words: What the person typed behind ``ikservo``.
    """
    arm, port = _given_arm(words), _value("--port", words)
    return COMMAND.sub(lambda found: _completed(found[1], found[2], arm, port), hint)


def _completed(name: str, arguments: str, arm: str, port: str) -> str:
    """Return a command with an arm and a port where it takes them and has none."""
    if "--help" in arguments:
        return f"ikservo {name}{arguments}"
    if arm and name in _ARM_AS_WORD:
        arguments = _with_word(arguments, _ARM_AS_WORD[name], shlex.quote(arm))
    elif arm and name in _ARM_AS_OPTION and "--arm" not in arguments:
        arguments += f" --arm {shlex.quote(arm)}"
    takes_port = name in _ARM_AS_WORD or (name in _ARM_AS_OPTION and name not in _NO_PORT)
    if port and takes_port and "--port" not in arguments:
        arguments += f" --port {shlex.quote(port)}"
    return f"ikservo {name}{arguments}"


def _with_word(arguments: str, place: int, arm: str) -> str:
    """Return arguments with the arm at its place, instead of ``ARM`` or where none stands."""
    if re.search(r"\bARM\b", arguments):
        return re.sub(r"\bARM\b", lambda _: arm, arguments)
    words = arguments.split()
    leading = next((i for i, word in enumerate(words) if word.startswith("-")), len(words))
    if leading <= place:
        words.insert(leading, arm)
    return " ".join(["", *words])


def _given_arm(words: Sequence[str]) -> str:
    """Return the arm of a command, given as an option or as a word of its own; nothing without."""
    named = _value("--arm", words)
    if named or not words or words[0] not in _ARM_AS_WORD:
        return named
    place = _ARM_AS_WORD[words[0]] + 1
    leading = [word for word in words[: place + 1] if not word.startswith("-")]
    return leading[place] if len(leading) > place else ""


def _value(name: str, words: Sequence[str]) -> str:
    """Return the value of an option, given as ``--arm x`` or ``--arm=x``; nothing without it."""
    for word, after in zip_longest(words, words[1:], fillvalue=""):
        if word == name:
            return after
        if word.startswith(f"{name}="):
            return word.partition("=")[2]
    return ""
