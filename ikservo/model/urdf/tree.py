"""Links and joints must form one tree; anything else is refused by the line that breaks it."""

from __future__ import annotations

import difflib
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

from ikservo.errors import FileFormatError
from ikservo.files.quoting import quoted
from ikservo.model.urdf.parts import UrdfJoint, UrdfLink

__all__ = ["find_root"]

_Part = UrdfLink | UrdfJoint


def find_root(path: Path, links: Sequence[UrdfLink], joints: Sequence[UrdfJoint]) -> str:
    """Return the name of the one link that no joint carries.

    Raises:
        FileFormatError: Names occur twice, links are missing, or the links form no single tree.
    """
    if not links:
        raise FileFormatError(path, "", "the robot has no links", "at least one <link>")
    _refuse_doubles(path, "link", links)
    _refuse_doubles(path, "joint", joints)
    _refuse_unknown_links(path, {link.name for link in links}, joints)
    _refuse_bad_mimics(path, joints)
    carriers = _carriers(path, joints)
    _refuse_cycles(path, carriers)
    return _only_root(path, [link for link in links if link.name not in carriers])


def _error(path: Path, part: _Part, found: str, expected: str) -> FileFormatError:
    return FileFormatError(path, f"line {part.line}", found, expected)


def _refuse_doubles(path: Path, kind: str, parts: Sequence[_Part]) -> None:
    lines: dict[str, int] = {}
    for part in parts:
        if part.name in lines:
            found = f"{kind} {quoted(part.name)} is already defined in line {lines[part.name]}"
            raise _error(path, part, found, "each name once")
        lines[part.name] = part.line


def _refuse_unknown_links(path: Path, names: Collection[str], joints: Sequence[UrdfJoint]) -> None:
    for joint in joints:
        for role, link in (("parent", joint.parent), ("child", joint.child)):
            if link not in names:
                found = (
                    f"joint {quoted(joint.name)} has the {role} {quoted(link)}, which is not a link"
                )
                raise _error(path, joint, found, _one_of(link, names))


def _refuse_bad_mimics(path: Path, joints: Sequence[UrdfJoint]) -> None:
    leaders = {joint.name for joint in joints if joint.kind.moves and joint.mimic is None}
    for joint in joints:
        if joint.mimic is not None and joint.mimic.joint not in leaders:
            followed = quoted(joint.mimic.joint)
            found = f"joint {quoted(joint.name)} mimics {followed}, which cannot be mimicked"
            raise _error(path, joint, found, "a joint that moves and mimics no other")


def _carriers(path: Path, joints: Sequence[UrdfJoint]) -> Mapping[str, UrdfJoint]:
    carriers: dict[str, UrdfJoint] = {}
    for joint in joints:
        other = carriers.setdefault(joint.child, joint)
        if other is not joint:
            found = f"joint {quoted(joint.name)} has the child {quoted(joint.child)}"
            already = f"which is already the child of {quoted(other.name)} in line {other.line}"
            raise _error(path, joint, f"{found}, {already}", "one parent for each link")
    return carriers


def _refuse_cycles(path: Path, carriers: Mapping[str, UrdfJoint]) -> None:
    grounded: set[str] = set()
    for start in carriers:
        trail: dict[str, UrdfJoint] = {}
        at = start
        while at in carriers and at not in grounded:
            if at in trail:
                found = f"joint {quoted(carriers[at].name)} closes a cycle of links"
                raise _error(path, carriers[at], found, "a tree without cycles")
            trail[at] = carriers[at]
            at = carriers[at].parent
        grounded.update(trail)


def _only_root(path: Path, roots: Sequence[UrdfLink]) -> str:
    if len(roots) > 1:
        both = f"neither link {quoted(roots[0].name)} nor {quoted(roots[1].name)}"
        found = f"{both} is the child of a joint"
        raise _error(path, roots[1], found, "exactly one root link")
    return roots[0].name


def _one_of(name: str, names: Collection[str]) -> str:
    close = difflib.get_close_matches(name, names, n=1)
    return f"the name of a <link>, perhaps {quoted(close[0])}" if close else "the name of a <link>"
