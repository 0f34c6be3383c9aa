"""Findings of the diagnostics and their severity."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

__all__ = ["Finding", "Severity", "failure", "ok", "warning"]


class Severity(StrEnum):
    """How much it matters; the value stands in JSON."""

    GOOD = "ok"
    ODD = "warning"
    BAD = "failed"

    @property
    def mark(self) -> str:
        """Return the sign in front of the line."""
        return _MARKS[self]


_MARKS = {Severity.GOOD: "✓", Severity.ODD: "!", Severity.BAD: "✗"}


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was looked at.

    Attributes:
        level: Good, odd or bad.
        topic: What was looked at, one word.
        text: What was found.
        fix: What to do about it; may have several lines.
    """

    level: Severity
    topic: str
    text: str
    fix: str = ""


def ok(topic: str, text: str) -> Finding:
    """Return a finding that needs no thought."""
    return Finding(Severity.GOOD, topic, text)


def warning(topic: str, text: str, fix: str = "") -> Finding:
    """Return a finding that somebody should know about."""
    return Finding(Severity.ODD, topic, text, fix)


def failure(topic: str, text: str, fix: str = "") -> Finding:
    """Return a finding that must be mended first."""
    return Finding(Severity.BAD, topic, text, fix)
