"""Remedies for both interfaces: the command line has commands, a program methods and arguments.

Hints are written once, as a user at a terminal would type them; the text for programs is derived
from that. Commands that no method replaces (``ikservo calibrate``, ``ikservo setup``) stay.
"""

from __future__ import annotations

import re

__all__ = ["in_python"]

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
    (r"--via\b", "arm.move_through([...])"),
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
_REMEDIES = [(re.compile(pattern), replacement) for pattern, replacement in _REPLACEMENTS]


def in_python(hint: str) -> str:
    """Return a hint with methods and arguments in place of commands and their options."""
    for pattern, replacement in _REMEDIES:
        hint = pattern.sub(replacement, hint)
    return hint
