"""A motion of the joints through way-points, without a stop at them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ikservo.errors import BadValueError
from ikservo.kinematics import finite_vector
from ikservo.motion.pace import Pace
from ikservo.motion.rounded import Rounded
from ikservo.motion.traverse import Traverse

__all__ = ["JointRoute"]


class JointRoute(Traverse):
    """A motion of n joints from point to point that rests only at its end.

    Between two way-points all joints keep step; at each but the last every joint passes at no
    more than 3/8 of the blend. No joint leaves the range that the way-points span.

    Args:
        start: Where it begins, at rest (n,), rad or m.
        points: Where it goes (k, n).
        paces: The pace of each joint.
        blends: How far from each of the k - 1 inner points, in the joint that goes furthest, the
            straight way is left; half of it at most. One number for all of them alike.

    Raises:
        BadValueError: A shape is wrong, a number is not finite, or a blend is not positive.
    """

    def __init__(
        self,
        start: ArrayLike,
        points: Sequence[ArrayLike],
        paces: Sequence[Pace],
        blends: float | Sequence[float],
    ) -> None:
        begin = finite_vector(start, len(paces), "The start of the route")
        corners = [finite_vector(point, len(paces), "A point of the route") for point in points]
        if not corners:
            raise BadValueError("The route", "empty", "at least one point")
        inner = len(corners) - 1
        radii = [blends] * inner if isinstance(blends, float | int) else list(blends)
        if len(radii) != inner:
            raise BadValueError("The list of blends", radii, f"{inner} of them")
        path = Rounded(np.array([begin, *corners]), radii, np.inf)
        super().__init__(path, paces, marks=path.marks)
