"""Error over iterations, one curve a method, on a logarithmic scale."""

# matplotlib leaves the types of its keywords open.
# pyright: reportUnknownMemberType=false

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ikservo.cli.plotting.sheet import lines_of
from ikservo.cli.reports.comparison import errors_along
from ikservo.ik import Result, Target, Tolerance
from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Vector

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.gridspec import SubplotSpec

__all__ = ["draw_errors"]

# What is below this is drawn here: a logarithm knows no zero.
_FLOOR = 1e-6
# Curves that stay this many times above what counts as reached are not drawn beside it.
_NEAR = 100.0


def draw_errors(
    figure: Figure,
    place: SubplotSpec,
    chain: Chain,
    target: Target,
    answers: Sequence[tuple[str, Result]],
) -> None:
    """Draw what is left of the way, and of the turn if one was wanted, at every iterate."""
    left = [np.array(errors_along(chain, target, result)) for _, result in answers]
    enough = Tolerance()
    rows = place.subgridspec(1 if target.only_position else 2, 1)
    axes = figure.add_subplot(rows[0])
    axes.set_title("Error at each iterate")
    pens = lines_of([name for name, _ in answers])
    curves_mm = [1000.0 * errors[:, 0] for errors in left]
    _draw_curves(axes, curves_mm, pens, "position error [mm]", 1000.0 * enough.position_m)
    if not target.only_position:
        axes.tick_params(labelbottom=False)
        axes = figure.add_subplot(rows[1], sharex=axes)
        curves_deg = [np.degrees(errors[:, 1]) for errors in left]
        limit_deg = math.degrees(enough.orientation_rad)
        _draw_curves(axes, curves_deg, pens, "angle left [°]", limit_deg)
    axes.set_xlabel("iteration")


def _draw_curves(
    axes: Axes,
    curves: Sequence[Vector],
    pens: Sequence[tuple[str, str]],
    what: str,
    enough: float,
) -> None:
    for curve, (colour, dashes) in zip(curves, pens, strict=True):
        shown = np.maximum(curve, _FLOOR)
        axes.plot(shown, dashes, color=colour, linewidth=1.8)
        axes.plot(len(shown) - 1, shown[-1], "o", color=colour, markersize=6.0)
    axes.set_yscale("log")
    if min(float(curve.min()) for curve in curves) < _NEAR * enough:
        _draw_enough(axes, enough)
    else:  # within a decade or two, where plain numbers are easier to read than powers
        axes.yaxis.set_major_formatter(_plain)
        axes.yaxis.set_minor_formatter(_plain)
    axes.set_xscale("symlog", linthresh=1.0)
    axes.set_xlim(0.0, 1.2 * max(len(curve) for curve in curves))
    axes.xaxis.set_major_formatter(_plain)
    axes.set_ylabel(what)
    axes.grid(visible=True, color="#e4e4e4", linewidth=0.6)
    axes.set_axisbelow(True)


def _plain(number: float, _place: float | None) -> str:
    return f"{number:g}"


def _draw_enough(axes: Axes, enough: float) -> None:
    """Draw the line below which a target counts as reached."""
    axes.axhline(enough, color="#6b6b6b", linewidth=1.0)
    axes.annotate("reached", (0.02, enough), xycoords=("axes fraction", "data"), va="top",
                  xytext=(0, -3), textcoords="offset points", color="#6b6b6b")  # fmt: skip
