"""``<joint>`` elements become joints."""

from __future__ import annotations

import math
from typing import NamedTuple

from ikservo.files.quoting import quoted
from ikservo.model.urdf.elements import Element
from ikservo.model.urdf.origins import read_origin
from ikservo.model.urdf.parts import JointKind, Mimic, UrdfJoint, Vector

__all__ = ["read_joint"]

_SHORTEST_AXIS = 1e-6


class _Limits(NamedTuple):
    lower: float
    upper: float
    effort: float
    velocity: float


def read_joint(element: Element) -> UrdfJoint:
    """Return one joint; whether its links and mimicked joint exist is checked with the tree."""
    name, kind = element.name(), _read_kind(element)
    xyz_m, rpy_rad = read_origin(element)
    limits = _read_limits(element, kind, name)
    return UrdfJoint(
        name=name,
        kind=kind,
        parent=element.required("parent").name("link"),
        child=element.required("child").name("link"),
        xyz_m=xyz_m,
        rpy_rad=rpy_rad,
        axis=_read_axis(element, kind),
        lower=limits.lower,
        upper=limits.upper,
        effort=limits.effort,
        velocity=limits.velocity,
        mimic=_read_mimic(element),
        line=element.line,
    )


def _read_kind(element: Element) -> JointKind:
    kinds = {kind.value: kind for kind in JointKind}
    text = element.text("type")
    if text not in kinds:
        found = f"joint {quoted(element.name())} is of type {quoted(text)}"
        raise element.error(found, f"one of {', '.join(kinds)}")
    return kinds[text]


def _read_axis(element: Element, kind: JointKind) -> Vector:
    axis = element.optional("axis")
    if axis is None:
        return (1.0, 0.0, 0.0)
    x, y, z = axis.vector("xyz", default=None)
    if not kind.moves:  # exporters write 0 0 0 here, and it means nothing
        return (1.0, 0.0, 0.0)
    largest = max(abs(x), abs(y), abs(z))
    if largest < _SHORTEST_AXIS:
        found = f"joint {quoted(element.name())} moves about an axis of zero length"
        raise axis.error(found, 'a direction, such as xyz="0 0 1"')
    x, y, z = x / largest, y / largest, z / largest  # first, so that no square overflows
    length = math.hypot(x, y, z)
    return (x / length, y / length, z / length)


def _read_limits(element: Element, kind: JointKind, name: str) -> _Limits:
    if kind is JointKind.FIXED:
        return _Limits(0.0, 0.0, math.inf, math.inf)
    if kind is JointKind.CONTINUOUS:
        limit = element.optional("limit")
        lower, upper = -math.inf, math.inf
    else:
        limit = element.required("limit")
        lower, upper = limit.number("lower", 0.0), limit.number("upper", 0.0)
        _refuse_empty_range(limit, name, lower, upper)
    if limit is None:
        return _Limits(lower, upper, math.inf, math.inf)
    return _Limits(lower, upper, _strength(limit, "effort"), _strength(limit, "velocity"))


def _refuse_empty_range(limit: Element, name: str, lower: float, upper: float) -> None:
    if lower > upper:
        found = f"joint {quoted(name)} has lower {lower:g} above upper {upper:g}"
        raise limit.error(found, "lower below upper")
    if lower == upper:
        found = f"joint {quoted(name)} has lower = upper = {lower:g}, so it cannot move"
        raise limit.error(found, 'its real range, or type="fixed"')


def _strength(limit: Element, attribute: str) -> float:
    if attribute not in limit.attributes:
        return math.inf
    value = limit.number(attribute)
    if value < 0:
        raise limit.error(f"<limit> has {attribute} {value:g}", "no negative number")
    return value


def _read_mimic(element: Element) -> Mimic | None:
    mimic = element.optional("mimic")
    if mimic is None:
        return None
    return Mimic(
        joint=mimic.name("joint"),
        multiplier=mimic.number("multiplier", 1.0),
        offset=mimic.number("offset", 0.0),
    )
