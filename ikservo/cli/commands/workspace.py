"""``ikservo workspace``: the region that the tip can reach inside the limits; nothing moves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from ikservo.cli.model_options import calibrated_model_from_option, describe_limit
from ikservo.cli.options import ArmOption, JsonOption, TipOption
from ikservo.cli.plots import axis_names, check_plot_file, plot_workspace
from ikservo.cli.quantities import parse_angle_rad, parse_coordinate_m, parse_length_m
from ikservo.cli.solve_reports import ask_about_millimetres, explain_unreachable
from ikservo.cli.terminal import print_json, print_lines
from ikservo.errors import ExitCode, InputError, format_point
from ikservo.ik import Result, Target, solve
from ikservo.ik.workspace import Clear, Workspace, quasi_random_joints, workspace
from ikservo.ik.workspace_grid import front_plane, side_plane, top_plane
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.model import Model

COLLIDES = "every posture found collides with the arm itself, the table or a box"
"""Reason why a point within the limits is excluded."""


class Slice(Enum):
    """The plane of a slice through the workspace."""

    SIDE = "side"
    TOP = "top"
    FRONT = "front"


def point_fields(
    model: Model, point_m: Sequence[float] | None, found: Result | None
) -> dict[str, object]:
    """Return the JSON fields of a requested point; empty if none was requested."""
    if found is None:
        return {}
    return {
        "point_m": point_m,
        "inside": found.reached,
        "distance_m": 0.0 if found.reached else found.position_error_m,
        "nearest_m": found.nearest_m,
        "collides": found.method == COLLIDES,
        "binding": [describe_limit(model, limit) for limit in found.binding],
    }


def point_lines(model: Model, point_m: Sequence[float] | None, found: Result | None) -> list[str]:
    """Return the lines of text about a requested point; empty if none was requested."""
    if point_m is None or found is None:
        return []
    if found.reached:
        return [f"{format_point(point_m)}  inside"]
    if found.method == COLLIDES:
        return [f"{format_point(point_m)}  outside: {COLLIDES}"]
    held = ", ".join(describe_limit(model, limit) for limit in found.binding)
    held = held or explain_unreachable(model.chain, Target(point_m))
    nearest = format_point(found.nearest_m)
    return [
        f"{format_point(point_m)}  outside: {held}",
        f"nearest  {nearest}, {found.position_error_m * 1000:.1f} mm away",
    ]


def region_fields(cut: Slice | None, region: Workspace | None) -> dict[str, object]:
    """Return the JSON fields of a slice or a volume; empty if there is none."""
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
    """Return the lines of text about a slice or a volume; empty if there is none."""
    if region is None:
        return []
    size = f"{region.size:.4f} {'m²' if region.is_slice else 'm³'}"
    lines = [
        workspace_title(model, cut, region),
        f"reachable  {region.count} cells of {region.grid.cell_m * 1000:g} mm, {size}",
    ]
    if region.extent_m is not None:
        shown = 2 if region.is_slice else 3  # the thickness of a slice is irrelevant
        ends = list(zip(axis_names(region), *region.extent_m, strict=True))[:shown]
        lines += [f"{name}  {low:z.3f} m to {high:z.3f} m" for name, low, high in ends]
    return lines


def workspace_title(model: Model, cut: Slice | None, region: Workspace) -> str:
    """Return the arm's name and the slice of its workspace."""
    T = region.grid.T_world_grid
    if cut is None:
        return f"{model.title}, whole workspace"
    if cut is Slice.TOP:
        return f"{model.title}, top: the plane at a height of {T[2, 3]:z.3f} m"
    yaw_deg = math.degrees(math.atan2(float(T[1, 0]), float(T[0, 0])))
    return f"{model.title}, {cut.value}: the vertical plane at {yaw_deg:z.0f}°"


_STARTS = 64  # number of start postures for a point whose first solution collides


@dataclass(frozen=True, kw_only=True)
class SliceOptions:
    """The plane to show; without a plane, the whole volume is shown."""

    cut: Annotated[
        Slice | None, typer.Option("--slice", help="Plane to show; default: the whole volume.")
    ] = None
    height_m: Annotated[
        float | None,
        typer.Option(
            "--height", help="Height of the top plane.", parser=parse_length_m, metavar="LENGTH"
        ),
    ] = None
    yaw_rad: Annotated[
        float | None,
        typer.Option(
            "--yaw",
            help="Angle of the side or front plane about the vertical.",
            parser=parse_angle_rad,
            metavar="ANGLE",
        ),
    ] = None

    def check(self) -> None:
        """Check for options that would be ignored, before any work is done.

        Raises:
            InputError: An option would be ignored.
        """
        if self.height_m is not None and self.cut is not Slice.TOP:
            raise InputError("--height needs --slice top.", "For side and front: --yaw.")
        if self.yaw_rad is not None and self.cut not in (Slice.SIDE, Slice.FRONT):
            raise InputError("--yaw needs --slice side or front.", "For top: --height.")

    def frame(self, model: Model, home: Vector) -> Matrix | None:
        """Compute the frame (4, 4) of the plane; None for the whole volume."""
        match self.cut:
            case None:
                return None
            case Slice.TOP:
                return top_plane(model.chain, home, self.height_m)
            case Slice.SIDE:
                return side_plane(model.chain, home, self.yaw_rad)
            case Slice.FRONT:
                return front_plane(model.chain, home, self.yaw_rad)


Cell = Annotated[
    float | None,
    typer.Option("--cell", help="Size of a cell; default: 5mm in a plane, 25mm in the volume.",
                 parser=parse_length_m, metavar="LENGTH"),
]  # fmt: skip
Point = Annotated[
    tuple[str, str, str] | None,
    typer.Option("--point", metavar="X Y Z", help="Test this point; exit 7 if it is out of reach."),
]
FreeOnly = Annotated[
    bool,
    typer.Option(
        "--collision/--no-collision",
        help="Leave out postures in which the arm touches itself, the table or a box.",
    ),
]
Plot = Annotated[Path | None, typer.Option("--plot", help="Draw to FILE.svg or FILE.png.")]


def command(
    *,
    arm: ArmOption = None,
    tip: TipOption = None,
    slicing: SliceOptions,
    cell: Cell = None,
    point: Point = None,
    plot: Plot = None,
    collision: FreeOnly = True,
    json: JsonOption = False,
) -> None:
    """Compute what the tip can reach inside this arm's limits; nothing moves.

    The limits come from the arm's calibration, or from its arm file if it has none. Places are
    left out if the arm would touch itself, the table or a box in every posture that reaches them.

    ikservo workspace --arm so101 --slice side --plot reach.svg
    ikservo workspace --arm so101 --point 0.25 0.05 0.15
    """
    from ikservo.arm.opening import make_collision_filter  # noqa: PLC0415  # loads servo modules

    slicing.check()
    if plot is not None:
        check_plot_file(plot)
    cut = slicing.cut
    model = calibrated_model_from_option(arm, tip)
    home = model.initial_joints()
    point_m = None if point is None else [parse_coordinate_m(text) for text in point]
    clear = make_collision_filter(model) if collision else None
    found = None if point_m is None else _solve_point(model, point_m, home, clear)
    region = None
    if found is None or cut or plot or cell is not None:
        region = workspace(model.chain, slicing.frame(model, home), cell, clear=clear)
    if region is not None and plot is not None:
        plot_workspace(region, model, home, workspace_title(model, cut, region), plot, point_m)
    if json:
        print_json("workspace", **point_fields(model, point_m, found), **region_fields(cut, region))
    else:
        print_lines([*point_lines(model, point_m, found), *region_lines(model, cut, region)])
    if found is not None and not found.reached:
        ask_about_millimetres(model.chain, point_m or (), "workspace --point {}")
        raise typer.Exit(ExitCode.UNREACHABLE)


def _solve_point(
    model: Model, point_m: Sequence[float], home: Vector, clear: Clear | None
) -> Result:
    """Find a collision-free solution for a point or, if none is found, the best solution."""
    best = solve(model.chain, Target(point_m), home)
    if clear is None or not best.reached:
        return best
    starts = [best.q, *quasi_random_joints(model.chain, _STARTS)]
    results = (solve(model.chain, Target(point_m), start) for start in starts)
    free = (result for result in results if result.reached and clear(result.q[None])[0])
    return next(free, replace(best, reached=False, method=COLLIDES))
