"""What pictures share: a sheet to draw on, the arm as a line, axes with units and equal scale."""

# matplotlib leaves the types of its keywords open.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ikservo.errors import IkservoError, InputError
from ikservo.ik import METHODS
from ikservo.kinematics.se3 import Matrix, Vector
from ikservo.model import Model

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["check_picture", "length_axes", "lines_of", "save", "sheet", "skeleton", "square"]

# Told apart by colour-blind people, too (Okabe and Ito, Color Universal Design, 2008).
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00")
_DASHES = ("-", "--", "-.", ":")


def check_picture(file: Path) -> None:
    """Refuse before any work is done what could not be drawn or written afterwards.

    Raises:
        InputError: The file is neither .svg nor .png, or its folder does not exist.
        IkservoError: matplotlib is not installed; names the extra.
    """
    if file.suffix.lower() not in (".svg", ".png"):
        raise InputError(f"{file} is neither .svg nor .png.", "Give --plot FILE.svg or FILE.png.")
    if not file.absolute().parent.is_dir():
        raise InputError(f"There is no folder {file.parent}.", "Make it, or give another --plot.")
    if find_spec("matplotlib") is None:
        raise IkservoError(
            "Pictures need matplotlib, which is not installed.", "Try: pip install 'ikservo[plot]'"
        )


def sheet(width_in: float, height_in: float) -> Figure:
    """Return an empty sheet, without any window."""
    from matplotlib.figure import Figure  # noqa: PLC0415

    return Figure(figsize=(width_in, height_in), layout="constrained")


def save(figure: Figure, file: Path) -> None:
    """Write the sheet; the same picture gives the same bytes.

    Raises:
        InputError: The file cannot be written.
    """
    from matplotlib import rc_context  # noqa: PLC0415

    svg = file.suffix.lower() == ".svg"
    try:
        with rc_context({"svg.hashsalt": "ikservo", "svg.fonttype": "none"}):
            figure.savefig(file, dpi=150, metadata={"Date": None} if svg else None)
    except OSError as error:
        raise InputError(
            f"{file} cannot be written: {error.strerror}.", "Give another --plot."
        ) from None


def lines_of(names: Sequence[str]) -> list[tuple[str, str]]:
    """Return colour and dashes of each line; a method has the same in every picture."""
    known = list(METHODS)
    places = [known.index(name) if name in known else i for i, name in enumerate(names)]
    return [(_COLOURS[i % 6], _DASHES[i // 6 % 4]) for i in places]


def skeleton(model: Model, q: Vector) -> tuple[Matrix, Matrix]:
    """Return the arm as a line.

    Returns:
        The origins (n, 3) [m] of the links from the base to the tip, and the places (dof, 3) of
        those joints that move.
    """
    chain = model.chain
    way = model.urdf.joints_to(chain.tip)
    links = [chain.base, *(joint.child for joint in way)]
    points = {link: chain.forward(q, link)[:3, 3] for link in links}
    joints = [points[joint.child] for joint in way if joint.kind.moves]
    return np.array([points[link] for link in links]), np.array(joints)


def square(axes: Axes, points: Matrix, side_m: float) -> None:
    """Show a square of the world with the points (n, 2) in the middle."""
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    low, high = middle - 0.5 * side_m, middle + 0.5 * side_m
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])


def length_axes(axes: Axes, across: str, up: str) -> None:
    """Label both axes with metres and draw them to the same scale."""
    axes.set_aspect("equal")
    axes.set_xlabel(f"{across} [m]")
    axes.set_ylabel(f"{up} [m]")
    axes.grid(visible=True, color="#e4e4e4", linewidth=0.6)
    axes.set_axisbelow(True)
