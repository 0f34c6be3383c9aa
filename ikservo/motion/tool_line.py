"""A straight line of the tool, or several with rounded corners, in the time the joints need."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ikservo.errors import BadValueError
from ikservo.kinematics import Chain, finite_vector
from ikservo.motion.pace import Pace
from ikservo.motion.rounded import Rounded
from ikservo.motion.tool_curve import tool_curve
from ikservo.motion.traverse import Traverse

__all__ = ["ToolLine", "ToolRoute"]

_BLEND_M = 0.02


class ToolRoute(Traverse):
    """A motion of a chain's joints that takes its tip along straight lines through points.

    It rests only at its end. At each point but the last it leaves the lines at the blend's
    distance, and passes the point at no more than 3/8 of it. On the lines it strays by less than
    half a millimetre.

    The tool's orientation is kept as well as the arm can: arms of four and five joints keep pitch
    and roll in the upright plane that their first joint turns, others the whole of it. With
    ``end`` the tool is turned evenly to how it stands there.

    Args:
        chain: The arm; ``start`` is inside its limits.
        start: The joints where it begins (dof,), rad or m.
        points_m: Where the tip goes (k, 3), metres, base frame.
        paces: The pace of each joint.
        speed_m_s: The fastest the tip may go.
        blend_m: How far from a point its two lines are left; half of a line at most.
        end: Joints (dof,) whose orientation the tool shall have at the end, as far as the arm can
            on its branch.
        strict: Whether the orientation shall be kept in the world, and nothing else will do.

    Attributes:
        length_m: The way of the tip.
        left_rad: How far the tool is from how it should stand, along the way (n,).

    Raises:
        LineError: Some point of the way is out of reach, or can only be reached by a jump of the
            joints; says which, how far along, and why.
        BadValueError: No finite numbers, or no positive speed or blend.
    """

    def __init__(
        self,
        chain: Chain,
        start: ArrayLike,
        points_m: Sequence[ArrayLike],
        paces: Sequence[Pace],
        *,
        speed_m_s: float = 0.25,
        blend_m: float = _BLEND_M,
        end: ArrayLike | None = None,
        strict: bool = False,
    ) -> None:
        if not 0.0 < speed_m_s < math.inf:
            raise BadValueError("The speed of the tool", speed_m_s, "a positive number of m/s")
        begin = finite_vector(start, chain.dof, "The start of the line")
        last = None if end is None else finite_vector(end, chain.dof, "The end of the line")
        corners = [finite_vector(point, 3, "The end of the line") for point in points_m]
        path = Rounded(
            np.array([chain.forward(begin)[:3, 3], *corners]), [blend_m] * (len(corners) - 1)
        )
        self.length_m = path.way()
        curve = tool_curve(chain, begin, path, last, strict=strict)
        self.left_rad = curve.left_rad
        stretch = curve.spline.length / max(path.length, 1e-9)
        marks = [mark * stretch for mark in path.marks]
        super().__init__(curve.spline, paces, speed_m_s, marks)


class ToolLine(ToolRoute):
    """One straight line of the tip; see ``ToolRoute``.

    Args:
        chain: The arm; ``start`` is inside its limits.
        start: The joints where the line begins (dof,), rad or m.
        goal_m: Where the tip goes (3,), metres, base frame.
        paces: The pace of each joint.
        speed_m_s: The fastest the tip may go.
        end: Joints (dof,) whose orientation the tool shall have at the end.
        strict: Whether the orientation shall be kept in the world, and nothing else will do.

    Raises:
        LineError: Some point of the line is out of reach, or can only be reached by a jump.
        BadValueError: No three finite numbers, or no positive speed.
    """

    def __init__(
        self,
        chain: Chain,
        start: ArrayLike,
        goal_m: ArrayLike,
        paces: Sequence[Pace],
        speed_m_s: float = 0.25,
        *,
        end: ArrayLike | None = None,
        strict: bool = False,
    ) -> None:
        super().__init__(chain, start, [goal_m], paces, speed_m_s=speed_m_s, end=end, strict=strict)
