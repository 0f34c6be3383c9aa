"""Draw the pictures of docs/lecture.md with ikservo's own solvers.

``python tools/lecture_pictures.py`` writes docs/pictures/lecture-*.svg; the same version gives the
same bytes.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import ikservo
from ikservo.cli.plots import line_styles, new_figure, save_figure
from ikservo.ik.planar import allowed_arcs, solve_planar_2r, solve_planar_3r

# matplotlib types its plots' arguments incompletely.
# pyright: reportUnknownMemberType=false

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["PICTURES", "main"]

_FOLDER = Path(__file__).parents[1] / "docs" / "pictures"
_ARM, _OTHER, _TARGET, _HELP, _GOOD = "#3f51b5", "#9fa8da", "#c62828", "#888888", "#2e7d32"


def two_links() -> Figure:
    """Return a figure with both elbow postures of two links, and the ring within their reach."""
    figure, axes = _plane()
    target = complex(0.25, 0.25)
    _circle(axes, 0j, 0.5)
    _circle(axes, 0j, 0.1)
    for angles, colour in zip(solve_planar_2r(0.3, 0.2, target), (_ARM, _OTHER), strict=True):
        _arm(axes, (0.3, 0.2), angles, colour)
    _mark(axes, target)
    return figure


def three_links() -> Figure:
    """Return a figure with the possible directions of the last of three links at a point."""
    figure, axes = _plane()
    links, limits = (0.3, 0.2, 0.12), ((-1.6, 1.6), (-2.2, 2.2), (-1.8, 1.8))
    target = complex(0.3, 0.25)
    _circle(axes, target, links[2])
    for elbow, colour in enumerate((_ARM, _OTHER)):
        for arc in allowed_arcs(links, limits, target)[elbow]:
            _directions(axes, target, (arc.lower_rad, arc.upper_rad), links[2], colour)
            middle = 0.5 * (arc.lower_rad + arc.upper_rad)
            _arm(axes, links, solve_planar_3r(*links, target, middle)[elbow], colour)
    _mark(axes, target)
    return figure


def methods() -> Figure:
    """Return a figure with the position error over the iterations of each method."""
    figure = new_figure(6.4, 3.6)
    axes = figure.add_subplot()
    chain = ikservo.load_model("so101").chain
    target = ikservo.Target((0.25, 0.12, 0.12))
    names = ["pseudo_inverse", "transpose", "ccd", "bounded"]
    for name, (colour, dashes) in zip(names, line_styles(names), strict=True):
        result = ikservo.solve(chain, target, method=name, trace=True)
        errors = [math.dist(chain.forward(q)[:3, 3], target.position) * 1e3 for q in result.trace]
        axes.semilogy(np.maximum(errors, 1e-6), dashes, color=colour, label=name)
    axes.set(xlabel="iteration", ylabel="error of the tip [mm]", xscale="symlog", ylim=(1e-6, 1e3))
    axes.legend()
    axes.grid(alpha=0.3)
    return figure


def null_space() -> Figure:
    """Return a figure with one tip of three links in several preferred postures."""
    figure, axes = _plane()
    model = ikservo.load_model("planar3")
    target = ikservo.Target(tuple(model.chain.forward(np.array([0.9, -1.2, -0.5]))[:3, 3]))
    for bend in np.linspace(-1.8, 1.8, 7):
        posture = ikservo.Posture(np.array([0.0, 0.0, bend]), np.array([0.0, 0.0, 1.0]))
        q0 = np.array([0.9, -1.2, -0.5])
        result = ikservo.solve(
            model.chain, target, q0, method="pseudo_inverse", posture=posture, max_iterations=2000
        )
        points = np.array([pose[:2, 3] for pose in model.chain.link_poses(result.q).values()])
        axes.plot(*points.T, "-o", color=_ARM, alpha=0.55, ms=3)
    _mark(axes, complex(*np.asarray(target.position)[:2]))
    return figure


PICTURES: Mapping[str, Callable[[], Figure]] = {
    "lecture-two-links.svg": two_links,
    "lecture-three-links.svg": three_links,
    "lecture-methods.svg": methods,
    "lecture-null-space.svg": null_space,
}


def _plane() -> tuple[Figure, Axes]:
    figure = new_figure(5.0, 4.0)
    axes = figure.add_subplot()
    axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    axes.grid(alpha=0.3)
    return figure, axes


def _circle(axes: Axes, centre: complex, radius: float) -> None:
    turn = np.linspace(0.0, math.tau, 181)
    axes.plot(
        centre.real + radius * np.cos(turn), centre.imag + radius * np.sin(turn), "--", color=_HELP
    )


def _directions(
    axes: Axes, target: complex, ends_rad: tuple[float, float], length_m: float, colour: str
) -> None:
    """Draw where the third joint can be: a part of the circle around the target."""
    turn = np.linspace(*ends_rad, 61)
    x, y = target.real - length_m * np.cos(turn), target.imag - length_m * np.sin(turn)
    axes.plot(x, y, color=colour, lw=5, solid_capstyle="butt", alpha=0.7)


def _arm(axes: Axes, links: tuple[float, ...], angles: tuple[float, ...], colour: str) -> None:
    points, heading = [0j], 0.0
    for link, angle in zip(links, angles, strict=True):
        heading += angle
        points.append(points[-1] + cmath.rect(link, heading))
    axes.plot([p.real for p in points], [p.imag for p in points], "-o", color=colour, lw=3, ms=5)


def _mark(axes: Axes, target: complex) -> None:
    axes.plot(target.real, target.imag, "+", color=_TARGET, ms=14, mew=3, zorder=5)


def main(folder: Path = _FOLDER) -> None:
    """Write every picture into a folder."""
    for name, draw in PICTURES.items():
        save_figure(draw(), folder / name)


if __name__ == "__main__":
    main()
