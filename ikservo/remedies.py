"""Remedies for each interface: the command line has commands, a program methods, a page buttons.

Hints are written once, as a user at a terminal would type them; the texts for programs and pages
are derived from that. Commands that nothing replaces there (``ikservo setup``) stay.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

__all__ = ["in_page", "in_python"]

_NUMBER = r"(-?[\d.]+\d)"

_REPLACEMENTS = [
    (rf"ikservo move {_NUMBER} {_NUMBER} {_NUMBER}", r"arm.move_to((\1, \2, \3))"),
    (r"ikservo (relax|where|stop)\b(?! [A-Z<])", r"arm.\1()"),
    (r"then: ikservo net acknowledge --port \S+", "then call arm.acknowledge()"),
    (r"acknowledge the stop\b", "call arm.acknowledge()"),
    (r"ikservo joints\b", "arm.move_joints()"),
    (r"ikservo pose (\w+)", r'arm.pose("\1")'),
    (r"--no-collision \(collisions=False\)", "--no-collision"),
    (r"--no-collision\b", "open_arm(..., collisions=False)"),
    (r"--uncalibrated\b", "open_arm(..., uncalibrated=True)"),
    (r"--overwrite\b", "overwrite=True"),
    (r"--foxglove-port (\d+)", r"foxglove_port=\1"),
    (r"without --line\b", "with arm.move_to()"),
    (r"--port (sim\b[^\s.,]*)", r'port="\1"'),
    (r"--port\b", "port="),
    (r", as in --arm (\w+)", r', as in open_arm("\1")'),
    (r"Give --arm\b", "Name it"),
    (r"--arm (\w+)", r'open_arm("\1")'),
    (r"to --arm\b", "to open_arm()"),
    (r"with --arm\b", "by the first argument of open_arm"),
    (r" \(--tip\)", ""),
]  # fmt: skip
_BUTTONS = [
    (r"ikservo relax\b(?! [A-Z<])", "acknowledge, then press Relax"),
    (r"See: ikservo where\b", "See Health on this page"),
    (r"ikservo where\b(?! [A-Z<])", "see Health on this page"),
    (r"ikservo calibrate\b(?! --)( \w+)?", "press Calibrate"),
    (r": (ikservo (?:recover|doctor|setup|scan))\b", r", in a terminal: \1"),
]
_PAGE_REMEDIES = [(re.compile(pattern), replacement) for pattern, replacement in _BUTTONS]
_REMEDIES = [(re.compile(pattern), replacement) for pattern, replacement in _REPLACEMENTS]


def in_page(hint: str) -> str:
    """Word a hint with the buttons of the page in place of commands."""
    return _replace(hint, _PAGE_REMEDIES)


def in_python(hint: str) -> str:
    """Word a hint with methods and arguments in place of commands and their options."""
    return _replace(hint, _REMEDIES)


def _replace(hint: str, remedies: Sequence[tuple[re.Pattern[str], str]]) -> str:
    for pattern, replacement in remedies:
        hint = pattern.sub(replacement, hint)
    return hint
