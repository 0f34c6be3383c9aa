"""Findings of the diagnostics and their severity."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Severity(StrEnum):
    """The severity of a finding; the value is used in JSON."""

    GOOD = "ok"
    ODD = "warning"
    BAD = "failed"

    @property
    def mark(self) -> str:
        """The symbol in front of the finding."""
        return _MARKS[self]


_MARKS = {Severity.GOOD: "✓", Severity.ODD: "!", Severity.BAD: "✗"}


@dataclass(frozen=True, slots=True)
class Finding:
    """The result of one check: severity, subject in one word, text, and lines with the remedy."""

    level: Severity
    topic: str
    text: str
    fix: str = ""


def ok(topic: str, text: str) -> Finding:
    """Return a finding without a problem."""
    return Finding(Severity.GOOD, topic, text)


def warning(topic: str, text: str, fix: str = "") -> Finding:
    """Return a finding that the user should know about."""
    return Finding(Severity.ODD, topic, text, fix)


def failure(topic: str, text: str, fix: str = "") -> Finding:
    """Return a fault that must be repaired first."""
    return Finding(Severity.BAD, topic, text, fix)
