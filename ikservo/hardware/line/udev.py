"""The udev rule that lets a person open their adapter on Linux: its text, and whether it is in."""

from __future__ import annotations

import sys
from pathlib import Path

__all__ = ["RULES_FILE", "has_udev", "installed_rules", "read_rules"]

RULES_FILE = "60-ikservo.rules"
_FOLDERS = (Path("/etc/udev/rules.d"), Path("/usr/lib/udev/rules.d"), Path("/run/udev/rules.d"))


def read_rules() -> str:
    """Return the rules: ``tools/60-ikservo.rules`` of the source, which the wheel carries too."""
    package = Path(__file__).absolute().parents[2]
    shipped = package / "_rules"
    folder = shipped if shipped.is_dir() else package.parent / "tools"
    return (folder / RULES_FILE).read_text("utf-8")


def installed_rules() -> Path | None:
    """Return where the rules are installed, None if they are not."""
    return next((f / RULES_FILE for f in _FOLDERS if (f / RULES_FILE).exists()), None)


def has_udev() -> bool:
    """Return whether this system uses such rules at all."""
    return sys.platform == "linux"
