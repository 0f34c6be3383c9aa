"""Figures of the workspace: the reachable area, with the arm at home."""

# matplotlib leaves the types of its keywords open.
# pyright: reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ikservo.cli.plot_solve import arm_polyline, label_length_axes, new_figure, save_figure
from ikservo.ik.workspace import Workspace
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.model import Model

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["axis_names", "draw"]

_FILL, _EDGE, _ARM, _POINT = "#cfe8e4", "#2a7f74", "#3c4043", "#c0392b"


def draw(
    region: Workspace,
    model: Model,
    home: Vector,
    title: str,
    file: Path,
    point_m: Sequence[float] | None = None,
) -> None:
    """Draw a slice as one picture, or a volume as its shadows from three sides.

    Args:
        region: What is reachable.
        model: The arm.
        home: The joints (dof,) in which the arm is drawn.
        title: What stands above.
        file: Where to; ``.svg`` or ``.png``.
        point_m: A point (3,) of the base frame to mark, if any.

    Raises:
        InputError: The file cannot be written.
    """
    views = [2] if region.is_slice else [2, 1, 0]
    figure = new_figure(6.0 * len(views), 6.0)
    arm_m, _ = arm_polyline(model, home)
    for place, along in enumerate(views):
        axes = figure.add_subplot(1, len(views), place + 1)
        _draw_reach(axes, region, along)
        _draw_arm(axes, np.delete(region.grid.to_grid(arm_m), along, axis=1))
        if point_m is not None:
            _mark_point(axes, np.delete(region.grid.to_grid([point_m])[0], along))
        label_length_axes(axes, *np.delete(axis_names(region), along))
    figure.suptitle(title)
    save_figure(figure, file)


def axis_names(region: Workspace) -> tuple[str, str, str]:
    """Name each axis of the grid after the base axis it runs along, or say that it leads out."""
    names = ("x", "y", "z")
    along = np.abs(region.grid.T_world_grid[:3, :3])
    u, v, w = (
        names[int(column.argmax())] if column.max() > 1 - 1e-9 else "out" for column in along.T
    )
    return u, v, w


def _draw_reach(axes: Axes, region: Workspace, along: int) -> None:
    from matplotlib.patches import PathPatch  # noqa: PLC0415
    from matplotlib.path import Path as Shape  # noqa: PLC0415

    loops = [Shape(loop, closed=False) for loop in map(_close_loop, region.outline(along))]
    if loops:
        whole = Shape.make_compound_path(*loops)
        axes.add_patch(PathPatch(whole, facecolor=_FILL, edgecolor=_EDGE, linewidth=1.0))


def _close_loop(loop: Matrix) -> Matrix:
    return np.vstack([loop, loop[:1]])


def _draw_arm(axes: Axes, joints_m: Matrix) -> None:
    axes.plot(*joints_m.T, "o-", color=_ARM, linewidth=3.0, markersize=5.0)


def _mark_point(axes: Axes, at_m: Vector) -> None:
    axes.plot(*at_m, "x", color=_POINT, markersize=10.0, markeredgewidth=2.0)
