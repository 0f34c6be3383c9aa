"""A rotation as three turns about given axes, as Euler angles are (wrists whose axes meet)."""

from __future__ import annotations

import cmath
from collections.abc import Iterator

import numpy as np

from ikservo.ik.closed_form.orbits import Spin, frame_across
from ikservo.kinematics.se3 import Matrix, Vector, exp_so3

__all__ = ["ThreeTurns"]

# A vector this close to its axis of turning has no angle about it.
_NO_ANGLE = 1e-9


class ThreeTurns:
    """Finds α, β, γ with ``R = Ra(α) Rb(β) Rc(γ)`` for unit axes a, b, c (3,) at zero."""

    def __init__(self, a: Vector, b: Vector, c: Vector) -> None:
        self._a, self._b, self._c = a, b, c
        self._across_a, self._across_c = frame_across(a), frame_across(c)
        self._c_by_b = Spin(self._across_a, b).of_vector(c)
        self._a_by_b = Spin(self._across_c, -b).of_vector(a)

    def __call__(self, R: Matrix, near_alpha_rad: float) -> Iterator[tuple[float, float, float]]:
        """Yield both ways to turn by R (3, 3), none where the axes do not allow it.

        ``a·R c = a·Rb(β) c`` gives β; what R c and R⁻¹ a then lack about a and c gives α and γ.
        Where c ends along a only α + γ (or α - γ) is determined, and α stays as near.
        """
        Rc, Ra = self._across_a @ (R @ self._c), self._across_c @ (R.T @ self._a)
        for beta in self._c_by_b.where_across(float(Rc[2])) or ():
            before = self._c_by_b.along(beta)
            if abs(before) < _NO_ANGLE:
                yield near_alpha_rad, beta, self._last(R, near_alpha_rad, beta)
                continue
            alpha = cmath.phase(complex(Rc[0], Rc[1]) / before)
            yield alpha, beta, cmath.phase(self._a_by_b.along(beta) / complex(Ra[0], Ra[1]))

    def _last(self, R: Matrix, alpha: float, beta: float) -> float:
        """Return γ: by how much Rc(γ) = Rb(β)⁻¹ Ra(α)⁻¹ R turns a vector across c."""
        u = self._across_c[0]
        turned = exp_so3(-beta * self._b) @ exp_so3(-alpha * self._a) @ R @ u
        e1, e2, _ = self._across_c @ turned
        return float(np.arctan2(e2, e1))
