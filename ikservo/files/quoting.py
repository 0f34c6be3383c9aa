"""How words from a file are shown in a message."""

from __future__ import annotations

__all__ = ["quoted"]

_LONGEST = 60


def quoted(text: str) -> str:
    """Return the text in quotes, cut short, with control characters spelled out."""
    short = text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1]}…"
    return f'"{short}"' if short.isprintable() else ascii(short)
