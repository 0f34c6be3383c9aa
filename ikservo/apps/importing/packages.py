"""Find the folders of the packages that a description names, and the files in them."""

from __future__ import annotations

import contextlib
import posixpath
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import unquote, urlsplit

from ikservo.errors import FileFormatError
from ikservo.files.reading import path_inside, quote, read_text

_LEVELS = 6
_MAX_MANIFEST_BYTES = 256 * 1024
_PACKAGE, _FILE, _FIND = "package://", "file://", "$(find "
_DESCRIPTION_FOLDERS = ("urdf", "urdfs", "robots", "robot", "xacro", "xml", "mjcf", "description")


@dataclass(slots=True)
class PackageFolders:
    """Lookup of packages: given by the user, or in folders above the description.

    Attributes:
        path: The description.
        given: Folders by package, as given by the user.
        folder: The folder whose files may be read; None: the folder of the description's package.
        used: Folders by package, as found so far.
        outside: Names of the meshes that were refused because they are outside all folders.
    """

    path: Path
    given: Mapping[str, Path] = field(default_factory=dict[str, Path])
    folder: Path | None = None
    used: dict[str, Path] = field(default_factory=dict[str, Path])
    outside: list[str] = field(default_factory=list[str])

    def find(self, name: str) -> Path | None:
        """Find the folder of a package by its name, or by the name in its package.xml.

        A folder that the user gave comes first. Then the folders above the description and their
        direct subfolders are searched, up to the root of a repository.
        """
        if name not in self.used:
            folder = self.given.get(name) or self._look_upwards(name)
            if folder is None:
                return None
            self.used[name] = folder
        return self.used[name]

    def find_mesh(self, filename: str) -> Path | None:
        """Return a mesh file in its package or in the description's own package, or None."""
        path = self._mesh_path(filename)
        if path is None and filename not in self.outside:
            self.outside.append(filename)
        return path

    def require(self, name: str) -> Path:
        """Return the folder of a required package.

        Raises:
            FileFormatError: The package is not found.
        """
        folder = self.find(name)
        if folder is None:
            found = f"it needs the package {quote(name)}, which is not among the parent folders"
            raise FileFormatError(self.path, "", found, f"its folder: --package {name}=FOLDER")
        return folder

    def own_folder(self) -> Path:
        """Return the folder of the description's package, or else the folder of the description."""
        own = self.path.absolute().parent
        for folder in self._folders_above():
            if (folder / "package.xml").is_file():
                return folder
        return own.parent if own.name.lower() in _DESCRIPTION_FOLDERS else own

    def _mesh_path(self, filename: str) -> Path | None:
        name, rest = "", ""
        if filename.startswith(_PACKAGE):
            name, _, rest = filename.removeprefix(_PACKAGE).partition("/")
        elif filename.startswith(_FIND):
            name, _, rest = filename.removeprefix(_FIND).partition(")/")
            name = name.strip()
        if name:
            folder = self.find(name)
            own = [path_inside(folder, rest)] if folder else []
            # A description copied out of its package may have its meshes next to it.
            own += [path_inside(self.own_folder(), each) for each in (rest, f"{name}/{rest}")]
            inside = [path for path in own if path is not None]
            return next((path for path in inside if path.is_file()), inside[0] if inside else None)
        place = self.path.absolute().parent
        if filename.startswith(_FILE) or posixpath.isabs(filename):
            text = unquote(urlsplit(filename).path) if filename.startswith(_FILE) else filename
            if text.startswith("//"):  # from file:///$(find NAME)/…; normpath keeps both
                text = f"/{text.lstrip('/')}"
            return self._inside(posixpath.normpath(text))
        return self._inside(posixpath.normpath(posixpath.join(place.as_posix(), filename)))

    def _inside(self, text: str) -> Path | None:
        """Return the path if it is in the folder of the description or of a package, else None."""
        for folder in (self.folder or self.own_folder(), self.own_folder(), *self.used.values()):
            for home in dict.fromkeys((folder.absolute(), folder.resolve())):
                if text.startswith(f"{home.as_posix()}/"):
                    return path_inside(home, posixpath.relpath(text, home.as_posix()))
        return None

    def _folders_above(self) -> list[Path]:
        found: list[Path] = []
        for folder in list(self.path.absolute().parents)[:_LEVELS]:
            found.append(folder)
            if (folder / ".git").exists():
                break
        return found

    def _look_upwards(self, name: str) -> Path | None:
        if not name or "/" in name or "\\" in name or name in (".", ".."):
            return None
        for folder in self._folders_above():
            if folder.name == name or _manifest_name(folder) == name:
                return folder
            if (folder / name).is_dir():
                return folder / name
        return None


_NAME_ELEMENT = re.compile(r"<name>\s*([\w.-]{1,128})\s*</name>")


def _manifest_name(folder: Path) -> str:
    """Return the name in a folder's package.xml; empty if there is no readable name."""
    manifest = folder / "package.xml"
    if not manifest.is_file():
        return ""
    with contextlib.suppress(FileFormatError):
        found = _NAME_ELEMENT.search(read_text(manifest, _MAX_MANIFEST_BYTES))
        return found[1] if found else ""
    return ""
