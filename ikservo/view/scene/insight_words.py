"""How freely the tip moves, and what is hidden, in words."""

from __future__ import annotations

import math

from ikservo.kinematics import Chain
from ikservo.kinematics.conditioning import conditioning
from ikservo.kinematics.se3 import Vector
from ikservo.view.pick.visibility import Seen
from ikservo.view.scene.insights import Insight

__all__ = ["insight_rows"]

_NEAR_RAD = math.radians(10.0)
_UNITS = {1: "m", 2: "m²", 3: "m³"}


def insight_rows(chain: Chain, q: Vector, insight: Insight | None) -> list[tuple[str, str, str]]:
    """Return rows of name, words and level: manipulability, nearest singularity, hidden links.

    Args:
        chain: The arm.
        q: Joints (dof,).
        insight: What is known of them besides; None for nothing yet.
    """
    measured = conditioning(chain, q)
    unit = _UNITS.get(len(measured.moves_m_rad), "")
    value = f"{measured.manipulability:.2g} {unit}, "
    rows = [("manipulability", f"{value}at worst {measured.slowest_m_rad * 1000:.0f} mm/rad", "")]
    if insight is None:
        return rows
    rows.append(("singularity", *_singularity(insight)))
    hidden = [_hidden(each) for each in insight.seen if not each.visible]
    return [*rows, ("hidden here", ", ".join(hidden), "")] if hidden else rows


def _singularity(insight: Insight) -> tuple[str, str]:
    found = insight.singularity
    if found is None:
        return "none inside the limits", ""
    words = f"{math.degrees(found.distance_rad):.1f}° away, mostly by {found.joint}"
    return words, "bad" if found.distance_rad < _NEAR_RAD else ""


def _hidden(seen: Seen) -> str:
    return f"{seen.link} (by {seen.hidden_by[0]})" if seen.hidden_by else seen.link
