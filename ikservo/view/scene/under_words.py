"""What is under the pointer, in words: what a press grabs, and what lies behind it."""

from __future__ import annotations

from collections.abc import Sequence

from ikservo.view.pick.under import Found
from ikservo.view.scene.texts import point

__all__ = ["under_rows"]

_WHAT = {"link": "", "fixed": "does not move", "object": "object"}
_TIP = {"name": "the tip comes here", "what": "", "at": "", "depth": "", "depth_m": None}


def under_rows(options: Sequence[Found | None], chosen: int) -> list[dict[str, object]]:
    """Return a row for each thing under the pointer: name, where it is hit, how far behind.

    Args:
        options: As ``Drag.under`` returns them; None is the plane where the tip would go.
        chosen: Which of them a press means.
    """
    first_m = min((found.hit.depth_m for found in options if found is not None), default=0.0)
    return [
        {**(_TIP if found is None else _row(found, first_m)), "chosen": index == chosen}
        for index, found in enumerate(options)
    ]


def _row(found: Found, first_m: float) -> dict[str, object]:
    behind_m = found.hit.depth_m - first_m
    return {
        "name": found.hit.link,
        "what": _WHAT[found.kind],
        "at": point(found.hit.point_m),
        "depth": "nearest" if behind_m <= 0.0 else f"{behind_m * 1000:.0f} mm behind",
        "depth_m": round(found.hit.depth_m, 6),
    }
