"""The picture of a search: the arm before and after, and the error on the way."""

# matplotlib leaves the types of its keywords open.
# pyright: reportUnknownMemberType=false

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ikservo.cli.output import point
from ikservo.cli.plotting.error_curves import draw_errors
from ikservo.cli.plotting.sheet import length_axes, lines_of, save, sheet, skeleton, square
from ikservo.ik import Result, Target
from ikservo.kinematics.se3 import Matrix, Vector
from ikservo.model import Model

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw"]

_BEFORE, _JOINT, _GROUND = "#9a9a9a", "#303030", "#6b6b6b"
_PANEL_IN, _LEGEND_IN = 5.0, 0.9
# An arm that stays within this height [m] has no side worth looking at.
_FLAT_M = 1e-3


def draw(
    file: Path, model: Model, target: Target, start: Vector, answers: Sequence[tuple[str, Result]]
) -> None:
    """Draw the arm at the start and at each answer, and the error along each trace.

    Args:
        file: Where to; ``.svg`` or ``.png``.
        model: The arm.
        target: What was wanted.
        start: Joints (dof,) before.
        answers: Each with its name; those with a trace get a curve.
    """
    poses = _poses(model, start, answers)
    views = _views(model, poses)
    columns = len(views) + any(result.trace for _, result in answers)
    figure = sheet(_PANEL_IN * columns, _PANEL_IN + _LEGEND_IN)
    places = figure.add_gridspec(1, columns)
    side_m = 1.15 * max(view.spread_m(poses, target.position) for view in views)
    for i, view in enumerate(views):
        _draw_view(figure.add_subplot(places[i]), view, poses, target.position, side_m)
    if columns > len(views):
        draw_errors(figure, places[-1], model.chain, target, answers)
    handles = figure.axes[0].get_lines()[: len(poses)]
    labels = [pose.label for pose in poses]
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False)
    figure.suptitle(f"{model.title}: the tip to {point(target.position.tolist())}", size=11)
    save(figure, file)


@dataclass(frozen=True, slots=True, eq=False)
class _Pose:
    """The arm as it is drawn once: its line (n, 3), its joints (k, 3), metres, and its pen."""

    line: Matrix
    joints: Matrix
    label: str
    colour: str
    dashes: str
    width: float

    @property
    def tip(self) -> Vector:
        return self.line[-1]


@dataclass(frozen=True, slots=True)
class _View:
    """One way to look at the arm: points (n, 3) of a pose with its tip at (3,), to paper (n, 2)."""

    title: str
    across: str
    up: str
    look: Callable[[Matrix, Vector], Matrix]

    def paper(self, poses: Sequence[_Pose], target_m: Vector) -> Matrix:
        drawn = [self.look(pose.line, pose.tip) for pose in poses]
        return np.vstack([*drawn, self.look(target_m[None, :], target_m)])

    def spread_m(self, poses: Sequence[_Pose], target_m: Vector) -> float:
        return float(np.ptp(self.paper(poses, target_m), axis=0).max())


def _poses(model: Model, start: Vector, answers: Sequence[tuple[str, Result]]) -> list[_Pose]:
    """Return before, grey, and after; later ones are thinner, so that equal ones show as bands."""
    poses = [_Pose(*skeleton(model, start), "before", _BEFORE, "-", 4.0)]
    widths = [4.0] if len(answers) == 1 else np.linspace(10.0, 2.0, len(answers))
    for (name, result), (colour, dashes), width in zip(
        answers, lines_of([name for name, _ in answers]), widths, strict=True
    ):
        label = name if result.reached else f"{name}, {_short(result)} short"
        poses.append(_Pose(*skeleton(model, result.q), label, colour, dashes, float(width)))
    return poses


def _short(result: Result) -> str:
    gap, angle_rad = f"{result.position_error_m * 1000:.1f} mm", result.orientation_error_rad
    return f"{gap} and {math.degrees(angle_rad):.1f}°" if angle_rad else gap


def _views(model: Model, poses: Sequence[_Pose]) -> list[_View]:
    """Return the side, in the plane that turns with the arm, and the top; flat arms have one."""
    top = _View("From above", "x", "y", lambda points, _: points[:, :2])
    heights = np.concatenate([pose.line[1:, 2] for pose in poses])
    if float(np.ptp(heights)) < _FLAT_M:
        return [top]
    centre = _base_axis(model, poses[0])

    def unrolled(points: Matrix, tip: Vector) -> Matrix:
        out = tip[:2] - centre
        length = math.hypot(*out)
        direction = out / length if length > _FLAT_M else np.array([1.0, 0.0])
        return np.column_stack([(points[:, :2] - centre) @ direction, points[:, 2]])

    return [_View("From the side, in the arm's own plane", "out from the base axis", "z", unrolled),
            top]  # fmt: skip


def _base_axis(model: Model, pose: _Pose) -> Vector:
    """Return where (2,) the first joint's axis stands on the ground; the origin if it lies."""
    axis = model.chain.jacobian(np.zeros(model.chain.dof))[3:, 0]
    return pose.joints[0, :2] if abs(axis[2]) > 0.99 else np.zeros(2)


def _draw_view(
    axes: Axes, view: _View, poses: Sequence[_Pose], target_m: Vector, side_m: float
) -> None:
    for pose in poses:
        axes.plot(*view.look(pose.line, pose.tip).T, pose.dashes, color=pose.colour,
                  linewidth=pose.width, solid_joinstyle="round")  # fmt: skip
    for pose in poses:
        axes.plot(*view.look(pose.joints, pose.tip).T, "o", color="white",
                  markeredgecolor=_JOINT, markersize=5.0)  # fmt: skip
    axes.plot(*view.look(target_m[None, :], target_m).T, "x", color="black", markersize=11.0,
              markeredgewidth=2.0)  # fmt: skip
    if view.up == "z":
        axes.axhline(0.0, color=_GROUND, linewidth=1.2, zorder=0.5)
    axes.set_title(view.title)
    square(axes, view.paper(poses, target_m), side_m)
    length_axes(axes, view.across, view.up)
