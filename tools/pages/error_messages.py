"""The page of all error messages, read from the calls that make them."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import ikservo
from ikservo import errors
from ikservo.errors import ExitCode, IkservoError
from pages.markdown import table

__all__ = ["ErrorMessage", "error_messages", "error_messages_page"]

_SOURCES = Path(ikservo.__file__).parent
_OPEN = "…"  # stands for a name, a number or a text

_INTRODUCTION = """# All error messages

This page is generated from the sources. `…` is a name, a number or a text that differs. Search this
page for the fixed words of your message (Ctrl-F). [Troubleshooting](../troubleshooting.md) explains
the exit codes.

A Python program gets the same text with methods instead of commands: `arm.relax()` for
`ikservo relax`.
"""


@dataclass(frozen=True, slots=True)
class ErrorMessage:
    """A message as it stands in the sources, with ``…`` for inserted values."""

    kind: type[IkservoError]
    message: str
    hint: str


def error_messages() -> list[ErrorMessage]:
    """Return every message with fixed words, once, in alphabetical order."""
    found = {each for path in sorted(_SOURCES.rglob("*.py")) for each in _messages_in(path)}
    readable = [each for each in found if re.search(r"[a-z]{2}", each.message)]
    return sorted(readable, key=lambda each: (each.message.lstrip(f"{_OPEN} :,"), each.hint))


def _messages_in(path: Path) -> Iterator[ErrorMessage]:
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            kind = getattr(errors, node.func.id, None)
            if isinstance(kind, type) and issubclass(kind, IkservoError) and node.args:
                message, hint = [*map(_text, node.args), ""][:2]
                yield ErrorMessage(kind, message, "" if hint == _OPEN else hint)


def _text(node: ast.expr) -> str:
    """Return a text of the sources, with ``…`` for each expression in it."""
    match node:
        case ast.Constant(value=value):
            return str(value)
        case ast.JoinedStr(values=values):
            return "".join(_text(value) for value in values)
        case ast.BinOp(left=left, right=right):
            return _text(left) + _text(right)
        case _:
            return _OPEN


def error_messages_page() -> str:
    """Return the page as Markdown: a table of messages for each exit code."""
    parts = [_INTRODUCTION]
    messages = error_messages()
    for exit_code in ExitCode:
        rows = [
            (f"{_escape(each.message)}", _escape(each.hint))
            for each in messages
            if each.kind.exit_code is exit_code
        ]
        if rows:
            parts.append(f"## Exit code {exit_code.value}: {exit_code.meaning}")
            parts.append(table(["message", "what to do"], rows))
    return "\n\n".join(parts) + "\n"


def _escape(text: str) -> str:
    return re.sub(r"([<>*_\[\]])", r"\\\1", text)
