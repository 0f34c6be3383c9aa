"""``ikservo workspace``: what the tip can reach inside the limits; nothing moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from ikservo.cli.choosing import known_model, start_of
from ikservo.cli.options import ArmOption, CollisionOption, JsonOption, TipOption
from ikservo.cli.output import print_json, print_lines
from ikservo.cli.plotting.sheet import check_picture
from ikservo.cli.plotting.workspace import draw
from ikservo.cli.quantities import parse_angle_rad, parse_length_m
from ikservo.cli.reports.reach import ask_about_millimetres
from ikservo.cli.reports.workspace import (
    COLLIDES,
    Slice,
    point_fields,
    point_lines,
    region_fields,
    region_lines,
    title,
)
from ikservo.errors import ExitCode, InputError
from ikservo.ik import Result, Target, solve
from ikservo.ik.workspace import Clear, front_plane, joint_samples, side_plane, top_plane, workspace
from ikservo.kinematics.se3 import Matrix, Vector
from ikservo.model import Model

__all__ = ["command"]

_STARTS = 64  # postures from which a point is tried whose first answer collides


Cut = Annotated[Slice | None, typer.Option("--slice", help="Cut it; the whole volume if absent.")]
Height = Annotated[
    float | None,
    typer.Option("--height", help="Of the top slice.", parser=parse_length_m, metavar="LENGTH"),
]
Yaw = Annotated[
    float | None,
    typer.Option("--yaw", help="Of side and front.", parser=parse_angle_rad, metavar="ANGLE"),
]
Cell = Annotated[
    float | None,
    typer.Option("--cell", help="5mm in a slice, else 25mm.", parser=parse_length_m,
                 metavar="LENGTH"),
]  # fmt: skip
Point = Annotated[
    tuple[str, str, str] | None,
    typer.Option("--point", metavar="X Y Z", help="Is it inside? Else exit 7."),
]
Plot = Annotated[Path | None, typer.Option("--plot", help="Draw it to FILE.svg or FILE.png.")]


def command(
    *,
    arm: ArmOption = None,
    tip: TipOption = None,
    cut: Cut = None,
    height: Height = None,
    yaw: Yaw = None,
    cell: Cell = None,
    point: Point = None,
    plot: Plot = None,
    collision: CollisionOption = True,
    json: JsonOption = False,
) -> None:
    """Say what the tip can reach inside this arm's limits; nothing moves.

    The limits are those of the arm's calibration, or of its arm file where there is none. What
    only a posture reaches in which the arm touches itself, the table or a box is left out.

    ikservo workspace --arm so101 --slice side --plot reach.svg
    ikservo workspace --arm so101 --point 0.25 0.05 0.15
    """
    _check(cut, height, yaw, plot)
    model = known_model(arm, tip)
    home = start_of(model)
    asked = None if point is None else [parse_length_m(text) for text in point]
    clear = _clearance(model) if collision else None
    found = None if asked is None else _answered(model, asked, home, clear)
    region = None
    if found is None or cut or plot or cell is not None:
        region = workspace(model.chain, _plane(model, home, cut, height, yaw), cell, clear=clear)
    if region is not None and plot is not None:
        draw(region, model, home, title(model, cut, region), plot, asked)
    if json:
        print_json("workspace", **point_fields(model, asked, found), **region_fields(cut, region))
    else:
        print_lines([*point_lines(model, asked, found), *region_lines(model, cut, region)])
    if found is not None and not found.reached:
        ask_about_millimetres(model.chain, asked or (), "workspace --point {}")
        raise typer.Exit(ExitCode.UNREACHABLE)


def _clearance(model: Model) -> Clear:
    from ikservo.arm.clearance import clearance_of  # noqa: PLC0415  # brings the servos along

    return clearance_of(model)


def _answered(model: Model, asked: Sequence[float], home: Vector, clear: Clear | None) -> Result:
    """Return joints for a point, free of collisions if any found are; else the best found."""
    best = solve(model.chain, Target(asked), home)
    if clear is None or not best.reached:
        return best
    starts = [best.q, *joint_samples(model.chain, _STARTS)]
    results = (solve(model.chain, Target(asked), start) for start in starts)
    free = (result for result in results if result.reached and clear(result.q[None])[0])
    return next(free, replace(best, reached=False, method=COLLIDES))


def _check(cut: Slice | None, height: float | None, yaw: float | None, plot: Path | None) -> None:
    """Refuse what would be ignored, before any work is done."""
    if height is not None and cut is not Slice.TOP:
        raise InputError("--height needs --slice top.", "For side and front: --yaw.")
    if yaw is not None and cut not in (Slice.SIDE, Slice.FRONT):
        raise InputError("--yaw needs --slice side or front.", "For top: --height.")
    if plot is not None:
        check_picture(plot)


def _plane(
    model: Model, home: Vector, cut: Slice | None, height: float | None, yaw: float | None
) -> Matrix | None:
    match cut:
        case None:
            return None
        case Slice.TOP:
            return top_plane(model.chain, home, height)
        case Slice.SIDE:
            return side_plane(model.chain, home, yaw)
        case Slice.FRONT:
            return front_plane(model.chain, home, yaw)
