"""Catalogue of arms: those that ship with ikservo, and those from other distributions."""

from __future__ import annotations

import re
from contextlib import suppress
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import cast

from ikservo.app_discovery import other_packages_have
from ikservo.errors import UnknownNameError, shown

ARM_FILE = "arm.toml"

ARMS_GROUP = "ikservo.arms"
"""Entry point group: each entry is a package whose folders with an ``arm.toml`` are arms."""

_NAME = re.compile(r"[A-Za-z0-9_-]{1,64}")
_SUFFIXES = (".toml", ".urdf", ".xacro", ".xml")
_MAX_SHOWN_CHARS = 80


def arm_names() -> list[str]:
    """Return the names of all arms in the catalogue, sorted."""
    return sorted({name for shelf in _arm_folders() for name in _arm_names_in(shelf)})


def find_arm(name_or_path: str | Path) -> Path:
    """Return the ``arm.toml`` or ``.urdf`` to which a name or path refers.

    A name becomes part of a path only if it is listed in a catalogue folder. A text that has
    a separator or ends in .toml, .urdf, .xacro or .xml is a path to such a file, or to a folder
    with an ``arm.toml``. No file is opened.

    Raises:
        UnknownNameError: There is no such arm; the closest name is suggested.
    """
    is_text = isinstance(cast("object", name_or_path), str | Path)
    text = str(name_or_path) if is_text else shown(name_or_path, str)
    if isinstance(name_or_path, Path) or ("/" in text or "\\" in text or text.endswith(_SUFFIXES)):
        path = Path(text)
        with suppress(OSError, ValueError):  # too long, a null byte, a folder without permission
            if path.suffix in _SUFFIXES and path.is_file():
                return path
            if (path / ARM_FILE).is_file():
                return path / ARM_FILE
        raise UnknownNameError("arm or arm file", _shorten_text(text), arm_names())
    for shelf in _arm_folders():
        if _NAME.fullmatch(text) and text in _arm_names_in(shelf):
            return shelf / text / ARM_FILE
    unknown = UnknownNameError("arm", _shorten_text(text), arm_names())
    if unknown.closest is None and _NAME.fullmatch(text):
        unknown.command_hint += f" Give the folder of your own arm as a path: ./{text}"
    raise unknown


def catalogue_name(path: Path) -> str | None:
    """Return an arm file's name in the catalogue, or None if it is elsewhere."""
    folder = path.absolute().parent
    return folder.name if folder.parent in _arm_folders() else None


def _arm_folders() -> tuple[Path, ...]:
    """Return the folders that contain one folder per arm; ikservo's own folders come first."""
    package = Path(__file__).absolute().parents[1]
    shipped = package / "_configs"
    return (shipped if shipped.is_dir() else package.parent / "configs", *_folders_of_others())


@cache
def _folders_of_others() -> tuple[Path, ...]:
    """Return the folders with arms that other distributions name in their entry points."""
    if not other_packages_have(ARMS_GROUP):
        return ()
    from importlib.metadata import entry_points  # noqa: PLC0415  # slow and rarely needed

    found: list[str] = []
    for point in entry_points(group=ARMS_GROUP):
        with suppress(Exception):  # a package that cannot be imported has no arms
            spec = find_spec(point.value)
            found += spec.submodule_search_locations or () if spec else ()
    return tuple(map(Path, found))


def _arm_names_in(shelf: Path) -> list[str]:
    if not shelf.is_dir():
        return []
    names = [folder.name for folder in shelf.iterdir() if _NAME.fullmatch(folder.name)]
    return [name for name in names if (shelf / name / ARM_FILE).is_file()]


def _shorten_text(text: str) -> str:
    return text if len(text) <= _MAX_SHOWN_CHARS else f"{text[: _MAX_SHOWN_CHARS - 1]}…"
