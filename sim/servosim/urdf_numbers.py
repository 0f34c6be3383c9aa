"""Numbers and frames in the elements of a URDF."""

from __future__ import annotations

from math import cos, sin
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

__all__ = ["Matrix", "numbers", "origin"]

Matrix = NDArray[np.float64]


def origin(element: Element) -> Matrix:
    """The homogeneous transform of an `<origin>`: fixed-axis roll, pitch, yaw."""
    origin = element.find("origin")
    roll, pitch, yaw = numbers(origin, "rpy", (0.0, 0.0, 0.0))
    cr, sr, cp, sp, cy, sy = cos(roll), sin(roll), cos(pitch), sin(pitch), cos(yaw), sin(yaw)
    T = np.eye(4)
    T[:3, :3] = (
        (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        (-sp, cp * sr, cp * cr),
    )
    T[:3, 3] = numbers(origin, "xyz", (0.0, 0.0, 0.0))
    return T


def numbers(element: Element | None, key: str, default: tuple[float, ...]) -> tuple[float, ...]:
    """Return the numbers of an attribute."""
    text = None if element is None else element.get(key)
    return default if text is None else tuple(float(word) for word in text.split())
