"""Postures in which an arm touches neither itself, the table nor a box of its arm file."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ikservo.guard import Box, Space
from ikservo.kinematics.se3 import Matrix
from ikservo.model import Model
from ikservo.model.shell import body_of

__all__ = ["clearance_of"]


def clearance_of(model: Model) -> Callable[[Matrix], NDArray[np.bool_]]:
    """Return a function from postures (n, dof) to whether each is free of collisions (n,)."""
    boxes = [Box(box.name, np.array(box.low_m), np.array(box.high_m)) for box in model.keep_out]
    return Space(body_of(model), model.floor_m, boxes).clear
