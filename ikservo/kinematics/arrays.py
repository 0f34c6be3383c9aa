"""Types of the arrays that everything computes with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["Matrix", "Vector"]

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
