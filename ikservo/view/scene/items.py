"""What the page can draw: plain dicts with points in CSS pixels, ready for JSON.

Every item has ``kind`` and ``style``; the order of a list is the order of painting::

    {"kind": "polygon",  "style": "measured", "rings": [[[x, y], …], …], …}   fill by non-zero rule
    {"kind": "polyline", "style": "floor",    "points": [[x, y], …]}
    {"kind": "circle",   "style": "tip",      "at": [x, y], "r": 4.0}
    {"kind": "cross",    "style": "target",   "at": [x, y], "r": 8.0}
    {"kind": "text",     "style": "scale",    "at": [x, y], "text": "10 cm"}

Rings of one polygon may overlap: filled together they are one shape; to outline it, stroke twice
the width first and fill over it. Items of a link carry ``link``, those of a joint ``joint``,
and its arc ``says`` in words where the joint is and who limits it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ikservo.kinematics.se3 import Matrix

__all__ = ["Item", "circle", "cross", "pixels", "polygon", "polyline", "polylines", "text"]

Item = dict[str, object]


def polygon(style: str, rings_px: Matrix | Sequence[ArrayLike], **names: str) -> Item:
    """Return closed outlines (k, 2), or equally long ones (n, k, 2), that are filled together."""
    even = isinstance(rings_px, np.ndarray)  # all rings at once are ten times as fast
    rings = pixels(rings_px) if even else [pixels(ring) for ring in rings_px]
    return {"kind": "polygon", "style": style, "rings": rings, **names}


def polyline(style: str, points_px: ArrayLike, **names: str) -> Item:
    """Return an open line through pixels (k, 2)."""
    return {"kind": "polyline", "style": style, "points": pixels(points_px), **names}


def polylines(style: str, lines_px: Matrix) -> list[Item]:
    """Return many lines (n, k, 2)."""
    return [{"kind": "polyline", "style": style, "points": line} for line in pixels(lines_px)]


def circle(style: str, at_px: ArrayLike, r_px: float, **names: str) -> Item:
    """Return a circle about a pixel (2,)."""
    return {"kind": "circle", "style": style, "at": pixels(at_px), "r": r_px, **names}


def cross(style: str, at_px: ArrayLike, r_px: float) -> Item:
    """Return a cross about a pixel (2,)."""
    return {"kind": "cross", "style": style, "at": pixels(at_px), "r": r_px}


def text(style: str, at_px: ArrayLike, words: str, **names: str) -> Item:
    """Return words whose left lower corner is at a pixel (2,)."""
    return {"kind": "text", "style": style, "at": pixels(at_px), "text": words, **names}


def pixels(points_px: ArrayLike) -> list[object]:
    """Return pixels (…, 2) as nested lists, to a tenth and never so far out that drawing fails."""
    px = np.asarray(points_px, dtype=np.float64)
    rounded: list[object] = (
        np.rint(np.minimum(np.maximum(px, -_FAR_PX), _FAR_PX) * 10) / 10
    ).tolist()
    return rounded


_FAR_PX = 1e5
