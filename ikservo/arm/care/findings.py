"""What a check-up found, one line at a time."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

__all__ = ["Finding", "Level", "bad", "good", "odd"]


class Level(StrEnum):
    """How much it matters; the value stands in JSON."""

    GOOD = "ok"
    ODD = "warning"
    BAD = "failed"

    @property
    def mark(self) -> str:
        """Return the sign in front of the line."""
        return _MARKS[self]


_MARKS = {Level.GOOD: "✓", Level.ODD: "!", Level.BAD: "✗"}


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was looked at.

    Attributes:
        level: Good, odd or bad.
        topic: What was looked at, one word.
        text: What was found.
        fix: What to do about it; may have several lines.
    """

    level: Level
    topic: str
    text: str
    fix: str = ""


def good(topic: str, text: str) -> Finding:
    """Return a finding that needs no thought."""
    return Finding(Level.GOOD, topic, text)


def odd(topic: str, text: str, fix: str = "") -> Finding:
    """Return a finding that somebody should know about."""
    return Finding(Level.ODD, topic, text, fix)


def bad(topic: str, text: str, fix: str = "") -> Finding:
    """Return a finding that must be mended first."""
    return Finding(Level.BAD, topic, text, fix)
