"""Figures of a solve (the arm before and after, errors per iteration) and of the workspace."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ikservo.cli.solve_reports import trace_errors
from ikservo.errors import IkservoError, InputError, format_point
from ikservo.files.writing import write_atomic
from ikservo.ik import METHODS, Result, Target, Tolerance
from ikservo.ik.workspace import Workspace
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.model import Model
from ikservo.remedies import install_command

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.gridspec import SubplotSpec

# matplotlib does not declare the types of its keyword arguments.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false


# Colours that colour-blind users can also distinguish (Okabe and Ito, Color Universal Design,
# 2008).
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00")
_DASHES = ("-", "--", "-.", ":")

_FILL, _EDGE, _ARM, _POINT = "#cfe8e4", "#2a7f74", "#3c4043", "#c0392b"


def check_plot_file(file: Path) -> None:
    """Check that the file and matplotlib can be used, before any work is done.

    Raises:
        InputError: The file is neither .svg nor .png, or its folder does not exist.
        IkservoError: matplotlib is not installed; the error names the extra.
    """
    if file.suffix.lower() not in (".svg", ".png"):
        raise InputError(
            f"{file} is neither an .svg nor a .png file.", "Give --plot FILE.svg or FILE.png."
        )
    if not file.absolute().parent.is_dir():
        raise InputError(f"There is no folder {file.parent}.", "Create it, or choose another file.")
    if find_spec("matplotlib") is None:
        hint = f"Install it: {install_command('plot')}"
        raise IkservoError("Plots need matplotlib, which is not installed.", hint)


def new_figure(width_in: float, height_in: float) -> Figure:
    """Make an empty figure without a window."""
    from matplotlib.figure import Figure  # noqa: PLC0415

    return Figure(figsize=(width_in, height_in), layout="constrained")


def save_figure(figure: Figure, file: Path) -> None:
    """Write the figure to a file; equal figures give equal bytes.

    Raises:
        FileWriteError: The file cannot be written.
    """
    from matplotlib import rc_context  # noqa: PLC0415

    picture, kind = io.BytesIO(), file.suffix.lower().removeprefix(".")
    with rc_context({"svg.hashsalt": "ikservo", "svg.fonttype": "none"}):
        metadata = {"Date": None} if kind == "svg" else None
        figure.savefig(picture, format=kind, dpi=150, metadata=metadata)
    write_atomic(file, picture.getvalue())


def line_styles(names: Sequence[str]) -> list[tuple[str, str]]:
    """Return the colour and dashes of each line, so that a method looks the same everywhere."""
    known = list(METHODS)
    places = [known.index(name) if name in known else i for i, name in enumerate(names)]
    return [(_COLOURS[i % 6], _DASHES[i // 6 % 4]) for i in places]


def arm_polyline(model: Model, q: Vector) -> tuple[Matrix, Matrix]:
    """Return the arm as a polyline.

    Returns:
        The origins (n, 3) [m] of the links from the base to the tip, and the positions (dof, 3) of
        the joints that move.
    """
    chain = model.chain
    path_joints = model.urdf.joints_to(chain.tip)
    links = [chain.base, *(joint.child for joint in path_joints)]
    points = {link: chain.forward(q, link)[:3, 3] for link in links}
    joints = [points[joint.child] for joint in path_joints if joint.kind.is_movable]
    return np.array([points[link] for link in links]), np.array(joints)


def label_length_axes(axes: Axes, across: str, up: str) -> None:
    """Label both axes in metres, and draw them to the same scale."""
    axes.set_aspect("equal")
    axes.set_xlabel(f"{across} [m]")
    axes.set_ylabel(f"{up} [m]")
    axes.grid(visible=True, color="#e4e4e4", linewidth=0.6)
    axes.set_axisbelow(True)


# Smaller values are drawn at this value, because the axis is logarithmic.
_FLOOR = 1e-6
# The tolerance line is drawn only if a curve comes within this factor of it.
_NEAR_FACTOR = 100.0


def plot_error_curves(
    figure: Figure,
    place: SubplotSpec,
    chain: Chain,
    target: Target,
    solutions: Sequence[tuple[str, Result]],
) -> None:
    """Draw the position error, and the orientation error if requested, at every iterate."""
    errors_by_solution = [np.array(trace_errors(chain, target, result)) for _, result in solutions]
    tolerance = Tolerance()
    rows = place.subgridspec(1 if target.only_position else 2, 1)
    axes = figure.add_subplot(rows[0])
    axes.set_title("Error at each iteration")
    styles = line_styles([name for name, _ in solutions])
    curves_mm = [1000.0 * errors[:, 0] for errors in errors_by_solution]
    _draw_curves(axes, curves_mm, styles, "position error [mm]", 1000.0 * tolerance.position_m)
    if not target.only_position:
        axes.tick_params(labelbottom=False)
        axes = figure.add_subplot(rows[1], sharex=axes)
        curves_deg = [np.degrees(errors[:, 1]) for errors in errors_by_solution]
        limit_deg = math.degrees(tolerance.orientation_rad)
        _draw_curves(axes, curves_deg, styles, "orientation error [°]", limit_deg)
    axes.set_xlabel("iteration")


def _draw_curves(
    axes: Axes,
    curves: Sequence[Vector],
    styles: Sequence[tuple[str, str]],
    what: str,
    tolerance: float,
) -> None:
    for curve, (colour, dashes) in zip(curves, styles, strict=True):
        shown = np.maximum(curve, _FLOOR)
        axes.plot(shown, dashes, color=colour, linewidth=1.8)
        axes.plot(len(shown) - 1, shown[-1], "o", color=colour, markersize=6.0)
    axes.set_yscale("log")
    if min(float(curve.min()) for curve in curves) < _NEAR_FACTOR * tolerance:
        axes.axhline(tolerance, color="#6b6b6b", linewidth=1.0)
        axes.annotate("reached", (0.02, tolerance), xycoords=("axes fraction", "data"), va="top",
                      xytext=(0, -3), textcoords="offset points", color="#6b6b6b")  # fmt: skip
    else:  # over a few decades plain numbers are easier to read
        axes.yaxis.set_major_formatter(_format_number)
        axes.yaxis.set_minor_formatter(_format_number)
    axes.set_xscale("symlog", linthresh=1.0)
    axes.set_xlim(0.0, 1.2 * max(len(curve) for curve in curves))
    axes.xaxis.set_major_formatter(_format_number)
    axes.set_ylabel(what)
    axes.grid(visible=True, color="#e4e4e4", linewidth=0.6)
    axes.set_axisbelow(True)


def _format_number(number: float, _place: float | None) -> str:
    return f"{number:g}"


_START_STYLE, _JOINT, _GROUND = "#9a9a9a", "#303030", "#6b6b6b"
_PANEL_IN, _LEGEND_IN = 5.0, 0.9
# An arm that stays below this height [m] gets no side view.
_FLAT_M = 1e-3


def plot_solution(
    file: Path, model: Model, target: Target, start: Vector, solutions: Sequence[tuple[str, Result]]
) -> None:
    """Draw the arm at the start (dof,) and at each solution, and the error along each trace.

    The suffix of the file is ``.svg`` or ``.png``. Results with a trace get a curve.
    """
    poses = [_PlotPose(*arm_polyline(model, start), "before", _START_STYLE, "-", 4.0)]
    # Later lines are thinner, so that equal ones stay visible.
    widths = [4.0] if len(solutions) == 1 else np.linspace(10.0, 2.0, len(solutions))
    styles = line_styles([name for name, _ in solutions])
    for (name, result), style, width in zip(solutions, styles, widths, strict=True):
        angle_rad = result.orientation_error_rad
        short = f"{result.position_error_m * 1000:.1f} mm"
        short += f" and {math.degrees(angle_rad):.1f}°" if angle_rad else ""
        label = name if result.reached else f"{name}, {short} short"
        poses.append(_PlotPose(*arm_polyline(model, result.q), label, *style, float(width)))
    views = _plot_views(model, poses)
    columns = len(views) + any(result.trace for _, result in solutions)
    figure = new_figure(_PANEL_IN * columns, _PANEL_IN + _LEGEND_IN)
    places = figure.add_gridspec(1, columns)
    side_m = 1.15 * max(view.extent_m(poses, target.position) for view in views)
    for i, view in enumerate(views):
        _draw_view(figure.add_subplot(places[i]), view, poses, target.position, side_m)
    if columns > len(views):
        plot_error_curves(figure, places[-1], model.chain, target, solutions)
    handles = figure.axes[0].get_lines()[: len(poses)]
    labels = [pose.label for pose in poses]
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False)
    figure.suptitle(f"{model.title}: the tip to {format_point(target.position)}", size=11)
    save_figure(figure, file)


@dataclass(frozen=True, slots=True, eq=False)
class _PlotPose:
    """A drawn posture: polyline (n, 3), joints (k, 3), metres, and line style."""

    line: Matrix
    joints: Matrix
    label: str
    colour: str
    dashes: str
    width: float

    @property
    def tip_point(self) -> Vector:
        return self.line[-1]


@dataclass(frozen=True, slots=True)
class _PlotView:
    """A view: projects points (n, 3) of a posture with its tip at (3,) to the page (n, 2)."""

    title: str
    across: str
    up: str
    project: Callable[[Matrix, Vector], Matrix]

    def project_points(self, poses: Sequence[_PlotPose], target_m: Vector) -> Matrix:
        projected = [self.project(pose.line, pose.tip_point) for pose in poses]
        return np.vstack([*projected, self.project(target_m[None, :], target_m)])

    def extent_m(self, poses: Sequence[_PlotPose], target_m: Vector) -> float:
        return float(np.ptp(self.project_points(poses, target_m), axis=0).max())


def _plot_views(model: Model, poses: Sequence[_PlotPose]) -> list[_PlotView]:
    """Return the side view, in the plane that rotates with the arm, and the top view."""
    top = _PlotView("From above", "x", "y", lambda points, _: points[:, :2])
    heights = np.concatenate([pose.line[1:, 2] for pose in poses])
    if float(np.ptp(heights)) < _FLAT_M:
        return [top]
    # The first joint's axis meets the ground at the centre, if it is vertical.
    axis = model.chain.jacobian(np.zeros(model.chain.dof))[3:, 0]
    centre = poses[0].joints[0, :2] if abs(axis[2]) > 0.99 else np.zeros(2)

    def into_arm_plane(points: Matrix, tip: Vector) -> Matrix:
        offset = tip[:2] - centre
        length = math.hypot(*offset)
        direction = offset / length if length > _FLAT_M else np.array([1.0, 0.0])
        return np.column_stack([(points[:, :2] - centre) @ direction, points[:, 2]])

    return [
        _PlotView(
            "From the side, in the arm's own plane",
            "distance from the base axis",
            "z",
            into_arm_plane,
        ),
        top,
    ]


def _draw_view(
    axes: Axes, view: _PlotView, poses: Sequence[_PlotPose], target_m: Vector, side_m: float
) -> None:
    for pose in poses:
        axes.plot(*view.project(pose.line, pose.tip_point).T, pose.dashes, color=pose.colour,
                  linewidth=pose.width, solid_joinstyle="round")  # fmt: skip
    for pose in poses:
        axes.plot(*view.project(pose.joints, pose.tip_point).T, "o", color="white",
                  markeredgecolor=_JOINT, markersize=5.0)  # fmt: skip
    axes.plot(*view.project(target_m[None, :], target_m).T, "x", color="black", markersize=11.0,
              markeredgewidth=2.0)  # fmt: skip
    if view.up == "z":
        axes.axhline(0.0, color=_GROUND, linewidth=1.2, zorder=0.5)
    axes.set_title(view.title)
    points = view.project_points(poses, target_m)
    left, bottom = 0.5 * (points.min(axis=0) + points.max(axis=0) - side_m)
    axes.set_xlim(left, left + side_m)
    axes.set_ylim(bottom, bottom + side_m)
    label_length_axes(axes, view.across, view.up)


def plot_workspace(
    region: Workspace,
    model: Model,
    home: Vector,
    title: str,
    file: Path,
    point_m: Sequence[float] | None = None,
) -> None:
    """Draw a slice as one picture, or a volume as its projections from three sides.

    The arm is drawn at ``home`` (dof,); a point (3,) of the base frame is marked, if given.

    Raises:
        InputError: The file cannot be written.
    """
    from matplotlib.patches import PathPatch  # noqa: PLC0415
    from matplotlib.path import Path as Shape  # noqa: PLC0415

    views = [2] if region.is_slice else [2, 1, 0]
    figure = new_figure(6.0 * len(views), 6.0)
    arm_m, _ = arm_polyline(model, home)
    for place, normal in enumerate(views):
        axes = figure.add_subplot(1, len(views), place + 1)
        loops = [np.vstack([loop, loop[:1]]) for loop in region.outline(normal)]
        if loops:
            outline = Shape.make_compound_path(*(Shape(loop, closed=False) for loop in loops))
            axes.add_patch(PathPatch(outline, facecolor=_FILL, edgecolor=_EDGE, linewidth=1.0))
        joints_m = np.delete(region.grid.to_grid(arm_m), normal, axis=1)
        axes.plot(*joints_m.T, "o-", color=_ARM, linewidth=3.0, markersize=5.0)
        if point_m is not None:
            at_m = np.delete(region.grid.to_grid([point_m])[0], normal)
            axes.plot(*at_m, "x", color=_POINT, markersize=10.0, markeredgewidth=2.0)
        label_length_axes(axes, *np.delete(axis_names(region), normal))
    figure.suptitle(title)
    save_figure(figure, file)


def axis_names(region: Workspace) -> tuple[str, str, str]:
    """Return the base axis to which each axis of the grid is parallel, or ``out``."""
    names = ("x", "y", "z")
    directions = np.abs(region.grid.T_world_grid[:3, :3])
    u, v, w = (
        names[int(column.argmax())] if column.max() > 1 - 1e-9 else "out" for column in directions.T
    )
    return u, v, w
