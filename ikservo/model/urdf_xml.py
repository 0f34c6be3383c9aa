"""Read the XML of a URDF safely, with the line numbers of its elements."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.parsers.expat import ErrorString

from defusedxml.common import DefusedXmlException
from defusedxml.ElementTree import DefusedXMLParser, ParseError

from ikservo.errors import FileFormatError
from ikservo.files.reading import quote
from ikservo.model.urdf_types import Triple

_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_MAX_NAME_CHARS = 128
LARGEST_NUMBER = 1e6
"""Largest number [m, rad, kg], because products of larger numbers overflow."""


@dataclass(slots=True)
class XmlElement:
    """One XML element, whose errors name its file and line; ``text_chars`` is the text's length."""

    path: Path
    tag: str
    attributes: Mapping[str, str]
    line: int
    children: list[XmlElement] = field(default_factory=list["XmlElement"])
    text_chars: int = 0

    def error(self, found: str, expected: str = "") -> FileFormatError:
        """Return an error that points to this element."""
        return FileFormatError(self.path, f"line {self.line}", found, expected)

    def child_elements(self, tag: str) -> list[XmlElement]:
        """Return the direct children with that tag."""
        return [child for child in self.children if child.tag == tag]

    def optional(self, tag: str) -> XmlElement | None:
        """Return the only child with that tag, or None."""
        found = self.child_elements(tag)
        if len(found) > 1:
            raise found[1].error(f"is a second <{tag}> in <{self.tag}>", "at most one")
        return found[0] if found else None

    def required(self, tag: str) -> XmlElement:
        """Return the only child with that tag."""
        child = self.optional(tag)
        if child is None:
            raise self.error(f"<{self.tag}> has no <{tag}>", f"<{tag} …/> inside it")
        return child

    def text(self, attribute: str) -> str:
        """Return a required attribute."""
        if attribute not in self.attributes:
            raise self.error(f"<{self.tag}> has no {attribute}", f'{attribute}="…"')
        return self.attributes[attribute]

    def name(self, attribute: str = "name") -> str:
        """Read an attribute that is a name: printable, neither empty nor too long."""
        name = self.text(attribute)
        if not name.strip() or not name.isprintable() or len(name) > _MAX_NAME_CHARS:
            expected = f"1 to {_MAX_NAME_CHARS} printable characters"
            raise self.error(f"<{self.tag}> has {attribute}={quote(name)}", expected)
        return name

    def number(
        self, attribute: str, default: float | None = None, most: float = LARGEST_NUMBER
    ) -> float:
        """Return one finite number whose magnitude is at most ``most``."""
        if default is not None and attribute not in self.attributes:
            return default
        return self._parse_numbers(attribute, 1, "one finite number", most)[0]

    def pair(self, attribute: str, most: float = LARGEST_NUMBER) -> tuple[float, float]:
        """Return two finite numbers."""
        first, second = self._parse_numbers(attribute, 2, "two finite numbers", most)
        return first, second

    def vector(
        self, attribute: str, default: float | None = None, most: float = LARGEST_NUMBER
    ) -> tuple[float, float, float]:
        """Return three finite numbers; ``default`` is used for all three."""
        if default is not None and attribute not in self.attributes:
            return (default, default, default)
        x, y, z = self._parse_numbers(attribute, 3, "three finite numbers", most)
        return x, y, z

    def _parse_numbers(
        self, attribute: str, count: int, expected: str, most: float = LARGEST_NUMBER
    ) -> list[float]:
        text = self.text(attribute)
        parts = text.split(maxsplit=count)
        if "${" in text:
            expected = f"plain numbers; convert it once: {import_command(self.path)}"
        numbers = [float(part) for part in parts if _NUMBER.fullmatch(part)]
        if len(parts) != count or len(numbers) != count or not all(map(math.isfinite, numbers)):
            raise self.error(f"<{self.tag}> has {attribute}={quote(text)}", expected)
        if max(map(abs, numbers)) > most:
            raise self.error(
                f"<{self.tag}> has {attribute}={quote(text)}", f"numbers within ±{most:g}"
            )
        return numbers


MAX_DEPTH = 64
MAX_ELEMENTS = 50_000  # a large humanoid has a few thousand; 4 MB must be read within a second

_PLAIN = "plain XML without <!DOCTYPE> and <!ENTITY>"


def parse_xml(path: Path, text: str) -> XmlElement:
    """Parse the outermost element of an XML text.

    The path is only for messages; the encoding that the text declares is ignored.

    Raises:
        FileFormatError: The text is not plain, well-formed XML; the line is named.
    """
    tree = _ElementBuilder(path)
    # The expat parser inside knows the line; the type stubs do not know that parser.
    parser: Any = DefusedXMLParser(target=tree, encoding="utf-8", forbid_dtd=True)
    tree.expat = parser.parser
    try:
        parser.feed(text.encode())
        return parser.close()
    except DefusedXmlException as error:
        found = "declares a document type (DTD)"
        raise FileFormatError(path, tree.where, found, _PLAIN) from error
    except ParseError as error:
        line, found = error.position[0], f"XML syntax error: {ErrorString(error.code)}"
        raise FileFormatError(path, f"line {line}", found, "well-formed XML") from error


class _ElementBuilder:
    """Builder of elements from the parser's calls; limits their depth and number."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.expat: Any = None
        self._root: list[XmlElement] = []
        self._open: list[XmlElement] = []
        self._count = 0

    @property
    def where(self) -> str:
        """Position of the parser in the file."""
        return f"line {self.expat.CurrentLineNumber}"

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        self._count += 1
        if len(self._open) >= MAX_DEPTH:
            self._raise_format_error(
                "elements are nested too deeply", f"at most {MAX_DEPTH} levels"
            )
        if self._count > MAX_ELEMENTS:
            self._raise_format_error("too many elements", f"at most {MAX_ELEMENTS}")
        element = XmlElement(self.path, tag, attributes, self.expat.CurrentLineNumber)
        siblings = self._open[-1].children if self._open else self._root
        siblings.append(element)
        self._open.append(element)

    def data(self, text: str) -> None:
        self._open[-1].text_chars += len(text)

    def end(self, tag: str) -> None:
        self._open.pop()

    def close(self) -> XmlElement:
        return self._root[0]

    def _raise_format_error(self, found: str, expected: str) -> None:
        raise FileFormatError(self.path, self.where, found, expected)


def parse_origin(element: XmlElement) -> tuple[Triple, Triple]:
    """Read xyz in metres and rpy in radians; zeros if the file gives none."""
    origin = element.optional("origin")
    if origin is None:
        return (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    return origin.vector("xyz", default=0.0), origin.vector("rpy", default=0.0)


MAX_URDF_BYTES = 4 * 1024 * 1024


_HEAD_BYTES = 64 * 1024


def is_mjcf(path: Path) -> bool:
    """Check whether a file begins like an MJCF file."""
    try:
        with path.open("rb") as file:
            return b"<mujoco" in file.read(_HEAD_BYTES)
    except OSError:
        return False  # the reader reports the cause


def import_command(path: Path) -> str:
    """Return the command that makes an arm's folder from a description in another format."""
    return f"ikservo arms new NAME --from {path}"
