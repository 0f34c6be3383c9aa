"""Wrap text at the terminal width; no word and no command that fits a line is broken."""

from __future__ import annotations

import os
import re
import shutil
import sys
from collections.abc import Iterator
from typing import TextIO

__all__ = ["fold", "fold_for_stream", "terminal_width"]

# A command begins at `ikservo` or another program's name and ends at punctuation.
_COMMAND = re.compile(r"(?:ikservo|sudo|pip|xacro)\s")
_ENDS = (".", ",", ";", ":", ")", "?")


def terminal_width(stream: TextIO) -> int | None:
    """Return the columns of a terminal; None where the stream is none, for no line is folded."""
    if not stream.isatty():
        return None
    columns = os.environ.get("COLUMNS", "")
    if columns.isdigit() and int(columns):
        return int(columns)
    try:
        return os.get_terminal_size(stream.fileno()).columns or None
    except (OSError, ValueError):
        return shutil.get_terminal_size().columns


def fold_for_stream(text: str, stream: TextIO = sys.stderr, indent: int = 0) -> str:
    """Return text folded for a stream, see `fold`; unchanged where that is no terminal."""
    width = terminal_width(stream)
    if width is None:
        return text
    return "\n".join("\n".join(fold(line, width, indent)) for line in text.split("\n"))


def fold(line: str, width: int, indent: int = 0) -> list[str]:
    """Return one line as lines of at most ``width`` columns.

    Args:
        line: What to fold; spaces at its start are kept.
        width: Columns of the terminal.
        indent: Columns by which all lines but the first are indented.

    A word that is longer than a line, such as a path, gets a line of its own and is left whole.
    """
    if len(line) <= width:
        return [line]
    lead = line[: len(line) - len(line.lstrip())]
    lines, current = list[str](), lead
    for chunk in _split_words(line[len(lead) :], width - max(indent, len(lead))):
        joined = f"{current} {chunk}" if current.strip() else f"{current}{chunk}"
        if len(joined) > width and current.strip():
            lines.append(current)
            joined = " " * max(indent, len(lead)) + chunk
        current = joined
    return [*lines, current]


def _split_words(text: str, width: int) -> Iterator[str]:
    """Yield words, a command that fits a line as one of them; runs of spaces stay inside words."""
    words = re.findall(r"\S+(?:\s+(?=\s))?", text)
    at = 0
    while at < len(words):
        end = _end_of_command(words, at)
        chunk = " ".join(words[at:end])
        if len(chunk) > width:
            chunk, end = words[at], at + 1
        yield chunk.rstrip() if end == len(words) else chunk
        at = end


def _end_of_command(words: list[str], start: int) -> int:
    """Return behind which word a command that begins at ``start`` ends; one word if none does."""
    if not _COMMAND.match(words[start].lstrip("('") + " "):
        return start + 1
    for at in range(start, len(words)):
        if words[at].rstrip().endswith(_ENDS):
            return at + 1
    return len(words)
