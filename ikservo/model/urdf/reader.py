"""A URDF file becomes a `Urdf`, or one error that names the file and the line."""

from __future__ import annotations

from pathlib import Path

from ikservo.files.reading import read_text
from ikservo.model.urdf.document import parse_xml
from ikservo.model.urdf.elements import Element
from ikservo.model.urdf.joints import read_joint
from ikservo.model.urdf.links import read_link
from ikservo.model.urdf.parts import Urdf
from ikservo.model.urdf.slips import find_slips
from ikservo.model.urdf.tree import find_root
from ikservo.model.urdf.xacro import expanded

__all__ = ["read_urdf"]

LARGEST_BYTES = 4 * 1024 * 1024

_XACRO = "xacro}"  # how its namespace ends; files spell the rest in several ways
_EXPAND = "plain URDF; run: xacro arm.urdf.xacro > arm.urdf"


def read_urdf(path: Path | str, folder: Path | None = None) -> Urdf:
    """Read the links, joints and simple shapes of a URDF; anything else in it is passed over.

    Nothing but the file itself is opened: no meshes, no includes, no document types.

    Args:
        path: The file; macros of one that ends in .xacro are expanded, where xacro is installed.
        folder: Under which its meshes may lie; its own if None.

    Source: the URDF XML specification, http://wiki.ros.org/urdf/XML

    Raises:
        FileFormatError: The file cannot be read or is not a usable URDF; ``where`` is the line.
    """
    path = Path(path)
    root = parse_xml(path, _text(path))
    _refuse_other_formats(root)
    home = path.parent if folder is None else folder
    links = tuple(read_link(each, home) for each in root.each("link"))
    joints = tuple(read_joint(each) for each in root.each("joint"))
    base = find_root(path, links, joints)
    name = root.name() if root.attributes.get("name") else ""
    return Urdf(name, links, joints, base, find_slips(root, links, joints))


def _text(path: Path) -> str:
    text = read_text(path, LARGEST_BYTES)
    return expanded(path) if path.suffix == ".xacro" else text


def _refuse_other_formats(root: Element) -> None:
    if root.tag != "robot":
        raise root.error(f"the outermost element is <{root.tag}>", "<robot>, as in a URDF")
    macros = [child for child in root.children if _XACRO in child.tag]
    if macros:
        raise macros[0].error("the macros are not expanded", _EXPAND)
