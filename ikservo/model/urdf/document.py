"""XML text becomes a tree of elements; document types, entities, depth and bulk are refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.parsers.expat import ErrorString

from defusedxml.common import DefusedXmlException
from defusedxml.ElementTree import DefusedXMLParser, ParseError

from ikservo.errors import FileFormatError
from ikservo.model.urdf.elements import Element

__all__ = ["parse_xml"]

DEEPEST = 64
MOST_ELEMENTS = 50_000  # a large humanoid has a few thousand; keeps a hostile 4 MB under a second

_PLAIN = "plain XML without <!DOCTYPE> and <!ENTITY>"


def parse_xml(path: Path, text: str) -> Element:
    """Return the outermost element of an XML text.

    Args:
        path: Where the text came from, for the messages; nothing is read from there.
        text: The whole document. An encoding declared inside is ignored: it is text already.

    Raises:
        FileFormatError: With the line where the text stops being plain, well-formed XML.
    """
    tree = _Tree(path)
    # The expat parser inside knows the line; the stubs do not know the parser inside.
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


class _Tree:
    """What the parser calls; builds elements and watches depth and bulk."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.expat: Any = None
        self._root: list[Element] = []
        self._open: list[Element] = []
        self._count = 0

    @property
    def where(self) -> str:
        """The place the parser has come to."""
        return f"line {self.expat.CurrentLineNumber}"

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        self._count += 1
        if len(self._open) >= DEEPEST:
            self._refuse("elements are nested too deeply", f"at most {DEEPEST} levels")
        if self._count > MOST_ELEMENTS:
            self._refuse("too many elements", f"at most {MOST_ELEMENTS}")
        element = Element(self.path, tag, attributes, self.expat.CurrentLineNumber)
        siblings = self._open[-1].children if self._open else self._root
        siblings.append(element)
        self._open.append(element)

    def end(self, tag: str) -> None:
        self._open.pop()

    def close(self) -> Element:
        return self._root[0]

    def _refuse(self, found: str, expected: str) -> None:
        raise FileFormatError(self.path, self.where, found, expected)
