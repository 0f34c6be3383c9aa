"""What ``ikservo workspace`` says: the same findings for a person and for a program."""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import Enum

from ikservo.cli.choosing import limit_words
from ikservo.cli.output import point as say_point
from ikservo.cli.plotting.workspace import axis_names
from ikservo.cli.reports.reach import why_short
from ikservo.ik import Result, Target
from ikservo.ik.workspace import Workspace
from ikservo.kinematics.se3 import Matrix
from ikservo.model import Model

__all__ = [
    "COLLIDES",
    "Slice",
    "point_fields",
    "point_lines",
    "region_fields",
    "region_lines",
    "title",
]


COLLIDES = "every posture found collides with the arm itself, the table or a box"
"""Why a point is left out that is in reach."""


class Slice(Enum):
    """How to cut the workspace; its whole volume where no cut is asked for."""

    SIDE = "side"
    TOP = "top"
    FRONT = "front"


def point_fields(
    model: Model, asked: Sequence[float] | None, found: Result | None
) -> dict[str, object]:
    """Return what JSON says of a point that was asked for; nothing if none was."""
    if found is None:
        return {}
    return {
        "point_m": asked,
        "inside": found.reached,
        "distance_m": 0.0 if found.reached else found.position_error_m,
        "nearest_m": found.nearest_m,
        "collides": found.method == COLLIDES,
        "binding": [limit_words(model, limit) for limit in found.binding],
    }


def point_lines(model: Model, asked: Sequence[float] | None, found: Result | None) -> list[str]:
    """Return what a person reads of a point that was asked for."""
    if asked is None or found is None:
        return []
    if found.reached:
        return [f"{say_point(asked)}  inside"]
    if found.method == COLLIDES:
        return [f"{say_point(asked)}  outside: {COLLIDES}"]
    held = ", ".join(limit_words(model, limit) for limit in found.binding)
    held = held or why_short(model.chain, Target(asked))
    nearest = say_point(found.nearest_m.tolist())
    return [
        f"{say_point(asked)}  outside: {held}",
        f"nearest  {nearest}, {found.position_error_m * 1000:.1f} mm away",
    ]


def region_fields(cut: Slice | None, region: Workspace | None) -> dict[str, object]:
    """Return what JSON says of a slice or a volume; nothing if none was made."""
    if region is None:
        return {}
    lower, upper = region.extent_m or (None, None)
    fields: dict[str, object] = {
        "slice": cut and cut.value,
        "cell_m": region.grid.cell_m,
        "cells": region.reachable.size,
        "reachable_cells": region.count,
        "area_m2" if region.is_slice else "volume_m3": region.size,
        "T_world_grid": region.grid.T_world_grid,
        "lower_m": lower,
        "upper_m": upper,
    }
    if region.is_slice:
        fields["outline_m"] = [loop.tolist() for loop in region.outline()]
    return fields


def region_lines(model: Model, cut: Slice | None, region: Workspace | None) -> list[str]:
    """Return what a person reads of a slice or a volume."""
    if region is None:
        return []
    size = f"{region.size:.4f} {'m²' if region.is_slice else 'm³'}"
    lines = [
        title(model, cut, region),
        f"reachable  {region.count} cells of {region.grid.cell_m * 1000:g} mm, {size}",
    ]
    if region.extent_m is not None:
        shown = 2 if region.is_slice else 3  # nobody asks how thick a slice is
        ends = list(zip(axis_names(region), *region.extent_m, strict=True))[:shown]
        lines += [f"{name}  {low:z.3f} m to {high:z.3f} m" for name, low, high in ends]
    return lines


def title(model: Model, cut: Slice | None, region: Workspace) -> str:
    """Return the arm's name and how its workspace was cut."""
    T = region.grid.T_world_grid
    if cut is None:
        return f"{model.title}, whole workspace"
    if cut is Slice.TOP:
        return f"{model.title}, top: the plane at a height of {T[2, 3]:z.3f} m"
    return f"{model.title}, {cut.value}: the upright plane along {_yaw_deg(T):z.0f}°"


def _yaw_deg(T: Matrix) -> float:
    return math.degrees(math.atan2(float(T[1, 0]), float(T[0, 0])))
