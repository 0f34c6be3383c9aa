"""Postures in which an arm touches neither itself, the table nor a box of its arm file."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ikservo.guard import CollisionChecker
from ikservo.kinematics.arrays import Matrix
from ikservo.model import Model
from ikservo.model.collision_model import collision_body

__all__ = ["make_collision_filter"]


def make_collision_filter(model: Model) -> Callable[[Matrix], NDArray[np.bool_]]:
    """Return a function from postures (n, dof) to whether each is free of collisions (n,)."""
    return CollisionChecker(collision_body(model), model.floor_m, model.keep_out).collision_free
