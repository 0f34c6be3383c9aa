"""Solve geometric subproblems: a cos + b sin = c, circles, rotations about two and three axes.

The plane is a (3, 3) ``frame`` with rows e1, e2, n. A vector has a component *along* the plane, e1
+ i e2, and a component *across* it, n. Rotating the parallel joints never changes the component
across, so yaw and roll can be found before these joints.

The yaw φ and the roll ψ must satisfy two equations::

        M(φ) = w(ψ)     the target point and the tool point are equally far across the plane
        d(φ) = a(ψ)     the target direction and the tool axis have equal parts across it

Both sides are linear in cos and sin, so eliminating φ leaves an equation of fourth degree
in e^{iψ}.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.se3 import exp_so3, skew

FULL_TURN_RAD = 2.0 * math.pi
# Rounding may move a solution at a limit past it by this much [rad]; it is clamped, which moves the
# tool by less than a nanometre.
LIMIT_TOLERANCE_RAD = 1e-9
# A cosine this far above one is a point on the boundary, after rounding.
_EDGE = 1e-10
# If an amplitude [m or 1] is this small, the angle does not matter.
_NEAR_ZERO = 1e-9


def wrap_angle(angle_rad: float) -> float:
    """Wrap an angle to the range from -π to π."""
    return math.remainder(angle_rad, FULL_TURN_RAD)


def clamped_acos(cosine: float) -> float | None:
    """Compute acos of a cosine that rounding may have moved just past ±1; None if it is larger."""
    if not abs(cosine) <= 1.0 + _EDGE:
        return None
    return math.acos(min(max(cosine, -1.0), 1.0))


def nearest_equivalent_angle(
    angle_rad: float, lower: float, upper: float, near_rad: float
) -> float | None:
    """Find the equivalent angle, angle + 2πk, that is inside the limits and nearest ``near_rad``.

    Return None if there is no such angle.
    """
    wrapped = angle_rad + FULL_TURN_RAD * round((near_rad - angle_rad) / FULL_TURN_RAD)
    if wrapped > upper:
        wrapped -= FULL_TURN_RAD * math.ceil(
            (wrapped - upper - LIMIT_TOLERANCE_RAD) / FULL_TURN_RAD
        )
    elif wrapped < lower:
        wrapped += FULL_TURN_RAD * math.ceil(
            (lower - wrapped - LIMIT_TOLERANCE_RAD) / FULL_TURN_RAD
        )
    if lower - LIMIT_TOLERANCE_RAD <= wrapped <= upper + LIMIT_TOLERANCE_RAD:
        return min(max(wrapped, lower), upper)
    return None


def solve_acos_bsin(a: float, b: float, c: float) -> tuple[float, ...] | None:
    """Compute the angles θ with ``a cos θ + b sin θ = c``: two, none, or None if all angles do."""
    amplitude = math.hypot(a, b)
    if amplitude < _NEAR_ZERO:
        return None if abs(c) < _NEAR_ZERO else ()
    spread = clamped_acos(c / amplitude)
    if spread is None:
        return ()
    middle = math.atan2(b, a)
    return (middle + spread, middle - spread)


@dataclass(frozen=True, slots=True)
class CircleTrace:
    """A circle: A0 + A1 cos θ + A2 sin θ in a plane, and a0 + a1 cos θ + a2 sin θ normal to it."""

    A0: complex
    A1: complex
    A2: complex
    a0: float
    a1: float
    a2: float

    def in_plane_part(self, theta_rad: float) -> complex:
        """Return the component in the plane, as the complex number e1 + i e2."""
        return self.A0 + self.A1 * math.cos(theta_rad) + self.A2 * math.sin(theta_rad)

    def normal_part(self, theta_rad: float) -> float:
        """Return the component normal to the plane."""
        return self.a0 + self.a1 * math.cos(theta_rad) + self.a2 * math.sin(theta_rad)

    def slope(self, theta_rad: float) -> float:
        """Return the derivative of the normal component with respect to θ."""
        return self.a2 * math.cos(theta_rad) - self.a1 * math.sin(theta_rad)

    def angles_at_normal(self, value: float) -> tuple[float, ...] | None:
        """Return the angles at which the normal component has a value; None if all angles do."""
        return solve_acos_bsin(self.a1, self.a2, value - self.a0)

    @property
    def amplitude(self) -> float:
        """The amplitude of the component normal to the plane."""
        return math.hypot(self.a1, self.a2)


class AxisRotation:
    """Rotations about one axis, prepared: ``R(θ) x = a (a·x) + cos θ (x - a (a·x)) + sin θ a × x``.

    Without an axis, the rotation is the identity.
    """

    __slots__ = ("_map", "_shift")

    def __init__(
        self, frame: Matrix, axis: Vector | None = None, point: Vector | None = None
    ) -> None:
        a = np.zeros(3) if axis is None else axis
        kept = np.eye(3) if axis is None else np.outer(a, a)
        self._map = np.vstack([frame @ kept, frame @ (np.eye(3) - kept), frame @ skew(a)])
        self._shift = np.zeros(9)
        if point is not None:
            self._shift -= self._map @ point
            self._shift[:3] += frame @ point

    def trace_point(self, x: Vector) -> CircleTrace:
        """Return the circle of a point (3,), m."""
        return _make_trace(self._map @ x + self._shift)

    def trace_vector(self, v: Vector) -> CircleTrace:
        """Return the circle of a vector (3,)."""
        return _make_trace(self._map @ v)


def plane_frame(n: Vector) -> Matrix:
    """Return the rows e1, e2, n; e1 is as near as possible to x, or to z if n is near x."""
    forward = np.array([0.0, 0.0, 1.0] if abs(n[0]) > 0.9 else [1.0, 0.0, 0.0])
    e1 = forward - n * float(forward @ n)
    e1 /= np.sqrt(e1 @ e1)
    return np.vstack([e1, np.cross(n, e1), n])


def _make_trace(rows: Vector) -> CircleTrace:
    x0, y0, z0, x1, y1, z1, x2, y2, z2 = rows.tolist()
    return CircleTrace(complex(x0, y0), complex(x1, y1), complex(x2, y2), z0, z1, z2)


# Circles this small [m or 1] give an arm no usable freedom.
NO_FREEDOM = 1e-6
# Published axes are rounded to about 1e-5 rad; a yaw that changes a direction by less has no
# effect.
ROUNDED = 1e-5
# A root of the quartic may be this far from the unit circle if two roots are nearly equal.
_BESIDE_CIRCLE = 1e-3
_NEWTON_STEPS = 4
_RESIDUAL = 1e-11
_ONE_PAIR = 1e-6


def solve_yaw_roll(
    M: CircleTrace, w: CircleTrace, d: CircleTrace, a: CircleTrace, held_rad: tuple[float, float]
) -> Iterator[tuple[float, float]]:
    """Yield every (φ, ψ) that gives ``M(φ) = w(ψ)`` and ``d(φ) = a(ψ)`` across the plane.

    An angle that does not matter stays at its value in ``held``, which is (φ, ψ). A direction that
    changes less than its tolerance, or a roll that moves nothing, leaves one equation.
    """
    roll_matters = max(w.amplitude, a.amplitude) > NO_FREEDOM
    direction_matters = max(d.amplitude, a.amplitude) > ROUNDED
    if not roll_matters or not direction_matters:
        phi, psi = held_rad
        angles = M.angles_at_normal(w.normal_part(psi))
        if angles is None:  # the point is on the yaw axis, so that only the direction decides
            angles = d.angles_at_normal(a.normal_part(psi))
        yield from ((angle, psi) for angle in ((phi,) if angles is None else angles))
        return
    found: list[tuple[float, float]] = []
    for psi in _quartic_rolls(M, w, d, a):
        if d.amplitude > M.amplitude:  # the equation with the larger amplitude gives the yaws
            yaws = d.angles_at_normal(a.normal_part(psi))
        else:
            yaws = M.angles_at_normal(w.normal_part(psi))
        for phi in yaws or ():
            pair = refine_angle_pair(M, w, d, a, phi, psi)
            if pair is not None and not any(_is_same_pair(pair, other) for other in found):
                found.append(pair)
    yield from found


def _quartic_rolls(
    M: CircleTrace, w: CircleTrace, d: CircleTrace, a: CircleTrace
) -> Iterator[float]:
    """Yield the angles ψ of the quartic's roots on the unit circle.

    With u = (cos φ, sin φ) and v = (cos ψ, sin ψ) the equations are ``A u = B v + b``. The
    adjugate of A gives ``det A u = C v + c``, and u has length one: ``|C v + c|² = det² A``. With
    y = e^{iψ} and ``C v = h y + h̄ / y`` that is a polynomial in y.
    """
    adjugate = np.array([[d.a2, -M.a2], [-d.a1, M.a1]])
    C = adjugate @ np.array([[w.a1, w.a2], [a.a1, a.a2]])
    c = adjugate @ np.array([w.a0 - M.a0, a.a0 - d.a0])
    det = M.a1 * d.a2 - M.a2 * d.a1
    h = 0.5 * (C[:, 0] - 1j * C[:, 1])
    middle = 2.0 * (h @ h.conj()) + c @ c - det * det
    for y in np.roots([h @ h, 2.0 * (h @ c), middle, 2.0 * (h.conj() @ c), (h @ h).conj()]):
        if abs(abs(y) - 1.0) < _BESIDE_CIRCLE:
            yield cmath.phase(complex(y))


def refine_angle_pair(
    M: CircleTrace, w: CircleTrace, d: CircleTrace, a: CircleTrace, phi: float, psi: float
) -> tuple[float, float] | None:
    """Refine the pair by Newton steps; return None if the equations do not hold afterwards."""
    for _ in range(_NEWTON_STEPS):
        e, f = w.normal_part(psi) - M.normal_part(phi), a.normal_part(psi) - d.normal_part(phi)
        if math.hypot(e, f) < _RESIDUAL:
            return phi, psi
        m1, w1, d1, a1 = M.slope(phi), -w.slope(psi), d.slope(phi), -a.slope(psi)
        det = m1 * a1 - w1 * d1
        if det == 0.0:
            return None
        phi += (e * a1 - f * w1) / det
        psi += (f * m1 - e * d1) / det
    return None


def _is_same_pair(first: tuple[float, float], second: tuple[float, float]) -> bool:
    return all(abs(wrap_angle(p - q)) < _ONE_PAIR for p, q in zip(first, second, strict=True))


# A vector this close to its axis of rotation has no angle about it.
_NO_EULER_ANGLE = 1e-9


class EulerAngles:
    """Solver for α, β, γ with ``R = Ra(α) Rb(β) Rc(γ)`` for unit axes a, b, c (3,) at zero."""

    def __init__(self, a: Vector, b: Vector, c: Vector) -> None:
        self._a, self._b, self._c = a, b, c
        self._across_a, self._across_c = plane_frame(a), plane_frame(c)
        self._c_by_b = AxisRotation(self._across_a, b).trace_vector(c)
        self._a_by_b = AxisRotation(self._across_c, -b).trace_vector(a)

    def __call__(self, R: Matrix, near_alpha_rad: float) -> Iterator[tuple[float, float, float]]:
        """Yield both solutions for R (3, 3), none if the axes do not allow it.

        ``a·R c = a·Rb(β) c`` gives β; the rest of R c about a and of R⁻¹ a about c gives α and γ.
        If c ends along a, only α + γ (or α - γ) is known, and α is ``near_alpha_rad``.
        """
        Rc, Ra = self._across_a @ (R @ self._c), self._across_c @ (R.T @ self._a)
        for beta in self._c_by_b.angles_at_normal(float(Rc[2])) or ():
            before = self._c_by_b.in_plane_part(beta)
            if abs(before) < _NO_EULER_ANGLE:
                # Rc(γ) = Rb(β)⁻¹ Ra(α)⁻¹ R rotates a vector across c by γ.
                undone = exp_so3(-beta * self._b) @ exp_so3(-near_alpha_rad * self._a) @ R
                e1, e2, _ = self._across_c @ (undone @ self._across_c[0])
                yield near_alpha_rad, beta, float(np.arctan2(e2, e1))
                continue
            alpha = cmath.phase(complex(Rc[0], Rc[1]) / before)
            yield alpha, beta, cmath.phase(self._a_by_b.in_plane_part(beta) / complex(Ra[0], Ra[1]))
