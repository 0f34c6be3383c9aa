"""The ``<origin>`` that joints, inertias and shapes share."""

from __future__ import annotations

from ikservo.model.urdf.elements import Element
from ikservo.model.urdf.parts import Vector

__all__ = ["read_origin"]


def read_origin(element: Element) -> tuple[Vector, Vector]:
    """Return xyz in metres and rpy in radians; zeros where the file gives none."""
    origin = element.optional("origin")
    if origin is None:
        return (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    return origin.vector("xyz", default=0.0), origin.vector("rpy", default=0.0)
