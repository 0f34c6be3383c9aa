"""The files that an MJCF names lie under the model's folder, or MuJoCo is not asked to read it."""

from __future__ import annotations

import posixpath
from pathlib import Path

from ikservo.errors import FileFormatError
from ikservo.files.quoting import quoted
from ikservo.files.reading import path_inside, read_text
from ikservo.model.urdf.document import parse_xml
from ikservo.model.urdf.elements import Element

__all__ = ["check_files"]

_LARGEST_BYTES = 4 * 1024 * 1024
_MOST_INCLUDES = 32
_FOLDERS = ("meshdir", "assetdir", "texturedir")


def check_files(path: Path, folder: Path) -> None:
    """Check every file name of an MJCF and of what it includes; opens only the XML files.

    Raises:
        FileFormatError: One leads out of the folder, or the XML cannot be used; says where.
    """
    waiting, seen = [path], set[Path]()
    while waiting:
        each = waiting.pop()
        if each in seen:
            continue
        seen.add(each)
        if len(seen) > _MOST_INCLUDES:
            raise FileFormatError(path, "", "it includes too many files", f"{_MOST_INCLUDES}")
        root = parse_xml(each, read_text(each, _LARGEST_BYTES))
        waiting.extend(_named(root, path, folder))


def _named(root: Element, path: Path, folder: Path) -> list[Path]:
    """Return the files that an XML includes, after all names in it were checked."""
    elements, bases = _all(root), [""]
    for element in elements:
        bases += [element.attributes[key] for key in _FOLDERS if key in element.attributes]
    included: list[Path] = []
    for element in elements:
        for key, name in element.attributes.items():
            if not key.startswith("file"):
                continue
            for base in bases:
                _inside(element, path.parent, folder, posixpath.join(base, name))
            if element.tag == "include":
                included.append(_inside(element, path.parent, folder, name))
    return included


def _inside(element: Element, place: Path, folder: Path, name: str) -> Path:
    home = folder.resolve()
    if place.resolve().is_relative_to(home) and not posixpath.isabs(name):
        way = posixpath.join(place.resolve().relative_to(home).as_posix(), name)
        found = path_inside(home, posixpath.normpath(way))
        if found is not None:
            return found
    raise element.error(
        f"<{element.tag}> names {quoted(name)}, outside the model's folder", "a file under it"
    )


def _all(root: Element) -> list[Element]:
    found = [root]
    for element in found:
        found.extend(element.children)
    return found
