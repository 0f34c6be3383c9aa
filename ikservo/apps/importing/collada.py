"""Compute the size of the scene in a Collada file (DAE) before its instances are expanded."""

from __future__ import annotations

from pathlib import Path

from ikservo.errors import FileFormatError
from ikservo.model.urdf_xml import XmlElement, parse_xml

_SURFACES = ("triangles", "polylist", "polygons", "tristrips", "trifans")
_MAX_LEVELS = 100
_MAX_CHARS = 32 * 1024 * 1024  # with every instance expanded


def check_collada(path: Path, place: str, data: bytes, max_elements: int) -> None:
    """Refuse a scene that is too large to be read with all its instances expanded.

    A node may instantiate another node several times, and that node may do the same, so thirty
    lines can make a billion surfaces. The path and ``place``, the owner of the shape, are used
    in messages.

    Raises:
        FileFormatError: The scene is too large, contains itself or is not plain XML.
    """
    root = parse_xml(path, data.decode("utf-8", "replace"))
    elements, chars = _SceneSize(path, place, root).sum_up()
    if elements > max_elements or chars > _MAX_CHARS:
        found = f"it has {elements:,} triangles and elements in {chars:,} characters"
        expected = f"at most {max_elements:,}, counting repeated parts each time"
        raise FileFormatError(path, place, found, f"{expected}; simplify the mesh")


class _SceneSize:
    """Sum of the elements, triangles and characters of a scene, counted once per instance."""

    def __init__(self, path: Path, place: str, root: XmlElement) -> None:
        self._path, self._place, self._root = path, place, root
        self._by_id: dict[str, XmlElement] = {}
        self._known: dict[str, tuple[int, int] | None] = {}
        self._note_ids(root)

    def sum_up(self) -> tuple[int, int]:
        """Return the number of elements (including triangles) and the number of characters."""
        scenes = [each for each in self._root.children if _tag(each) == "scene"]
        sizes = [self._size(scene, 0) for scene in scenes]
        return sum(size[0] for size in sizes), sum(size[1] for size in sizes)

    def _note_ids(self, element: XmlElement) -> None:
        self._by_id.setdefault(element.attributes.get("id", ""), element)
        for child in element.children:
            self._note_ids(child)

    def _size(self, element: XmlElement, level: int) -> tuple[int, int]:
        if level > _MAX_LEVELS:
            raise self._error("it nests its nodes too deeply", f"at most {_MAX_LEVELS} levels")
        elements, chars = 1, element.text_chars
        if _tag(element) in _SURFACES:
            stated = element.attributes.get("count", "")
            elements += int(stated) if stated.isdecimal() and len(stated) < 10 else 0
        name = element.attributes.get("url", "").removeprefix("#")
        if _tag(element).startswith("instance_") and name and name in self._by_id:
            if name not in self._known:
                self._known[name] = None
                self._known[name] = self._size(self._by_id[name], level + 1)
            more = self._known[name]
            if more is None:
                raise self._error("it has a node that contains itself", "nodes without a cycle")
            elements, chars = elements + more[0], chars + more[1]
        for child in element.children:
            more = self._size(child, level + 1)
            elements, chars = elements + more[0], chars + more[1]
        return elements, chars

    def _error(self, found: str, expected: str) -> FileFormatError:
        return FileFormatError(self._path, self._place, found, expected)


def _tag(element: XmlElement) -> str:
    return element.tag.rpartition("}")[2]
