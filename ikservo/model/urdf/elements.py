"""XML as a tree of elements that remember their line, and read their own attributes strictly."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from ikservo.errors import FileFormatError
from ikservo.files.quoting import quoted

__all__ = ["Element"]

_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_LONGEST_NAME = 128


@dataclass(slots=True)
class Element:
    """One XML element; every complaint about it names the file and its line."""

    path: Path
    tag: str
    attributes: Mapping[str, str]
    line: int
    children: list[Element] = field(default_factory=list["Element"])

    def error(self, found: str, expected: str = "") -> FileFormatError:
        """Return the error that points at this element."""
        return FileFormatError(self.path, f"line {self.line}", found, expected)

    def each(self, tag: str) -> list[Element]:
        """Return the direct children with that tag."""
        return [child for child in self.children if child.tag == tag]

    def optional(self, tag: str) -> Element | None:
        """Return the only child with that tag, or None."""
        found = self.each(tag)
        if len(found) > 1:
            raise found[1].error(f"is a second <{tag}> in <{self.tag}>", "at most one")
        return found[0] if found else None

    def required(self, tag: str) -> Element:
        """Return the only child with that tag."""
        child = self.optional(tag)
        if child is None:
            raise self.error(f"<{self.tag}> has no <{tag}>", f"<{tag} …/> inside it")
        return child

    def text(self, attribute: str) -> str:
        """Return an attribute that must be there."""
        if attribute not in self.attributes:
            raise self.error(f"<{self.tag}> has no {attribute}", f'{attribute}="…"')
        return self.attributes[attribute]

    def name(self, attribute: str = "name") -> str:
        """Return an attribute that names something: printable, neither empty nor endless."""
        name = self.text(attribute)
        if not name.strip() or not name.isprintable() or len(name) > _LONGEST_NAME:
            expected = f"1 to {_LONGEST_NAME} printable characters"
            raise self.error(f"<{self.tag}> has {attribute}={quoted(name)}", expected)
        return name

    def number(self, attribute: str, default: float | None = None) -> float:
        """Return one finite number."""
        if default is not None and attribute not in self.attributes:
            return default
        return self._numbers(attribute, 1, "one finite number")[0]

    def vector(self, attribute: str, default: float | None = None) -> tuple[float, float, float]:
        """Return three finite numbers; ``default`` stands for all three."""
        if default is not None and attribute not in self.attributes:
            return (default, default, default)
        x, y, z = self._numbers(attribute, 3, "three finite numbers")
        return x, y, z

    def _numbers(self, attribute: str, count: int, expected: str) -> list[float]:
        text = self.text(attribute)
        words = text.split(maxsplit=count)
        if "${" in text:
            expected = "plain numbers; expand the macros first: xacro arm.urdf.xacro > arm.urdf"
        numbers = [float(word) for word in words if _NUMBER.fullmatch(word)]
        if len(words) != count or len(numbers) != count or not all(map(math.isfinite, numbers)):
            raise self.error(f"<{self.tag}> has {attribute}={quoted(text)}", expected)
        return numbers
