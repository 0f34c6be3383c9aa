"""The public questions: solve once, or prepare a solver for a loop."""

from __future__ import annotations

from typing import Literal

from numpy.typing import ArrayLike

from ikservo.errors import UnknownNameError
from ikservo.ik.methods import method_named
from ikservo.ik.options import Options, Posture, Tolerance
from ikservo.ik.result import Result
from ikservo.ik.target import Target
from ikservo.kinematics import Chain, finite_vector
from ikservo.kinematics.se3 import Matrix, Vector

__all__ = ["Solver", "solve"]


def solve(
    chain: Chain,
    target: Target,
    q0: ArrayLike | None = None,
    method: str = "auto",
    *,
    tolerance: Tolerance | None = None,
    restarts: int = 40,
    max_iterations: int | None = None,
    posture: Posture | None = None,
    trace: bool = False,
) -> Result:
    """Find joints inside the limits that bring the point to the target (lecture L5, L13).

    With fewer than six joints the position comes first: it is met exactly where the limits
    allow, and the orientation as well as what remains allows.

    Args:
        chain: The arm; its limits are never left, not even by one ulp.
        target: What is wanted.
        q0: Where to start (dof,), rad or m; may lie outside the limits. The middle if None.
        method: ``auto`` or one of ``METHODS``.
        tolerance: How close counts as reached.
        restarts: How many starting points to try at most, the given one first.
        max_iterations: How many steps from one start; the method's own number if None.
        posture: A configuration to lean towards where the target leaves freedom.
        trace: Whether the result shall carry every iterate.

    Returns:
        The solution, or the nearest point that was found and the limits that bind there.

    Raises:
        BadValueError: q0 has a wrong shape or is not finite, or an option makes no sense.
        UnknownNameError: No such method, or the target's frame is no link of the arm.
    """
    options = Options(tolerance or Tolerance(), restarts, max_iterations, posture, trace)
    start = chain.middle() if q0 is None else finite_vector(q0, chain.dof, "q0")
    return method_named(method)(chain, target, start, options)


class Solver:
    """A question prepared once and asked in a loop, always from where the arm is.

    Calls never restart, so that neighbouring targets get neighbouring joints.
    """

    def __init__(
        self,
        chain: Chain,
        kind: Literal["position", "direction", "pose"] = "position",
        *,
        tool_axis: ArrayLike = (0.0, 0.0, 1.0),
        tolerance: Tolerance | None = None,
    ) -> None:
        if kind not in ("position", "direction", "pose"):
            raise UnknownNameError("kind of target", kind, ("position", "direction", "pose"))
        self.chain, self.kind = chain, kind
        self._tool_axis = finite_vector(tool_axis, 3, "tool_axis")
        self._tolerance = tolerance or Tolerance()

    def __call__(self, T_world_tool: Matrix, q0: ArrayLike) -> tuple[Vector, bool]:
        """Return joints (dof,) for the pose (4, 4) from ``q0`` (dof,), and whether they reach."""
        result = solve(
            self.chain, self._target(T_world_tool), q0, tolerance=self._tolerance, restarts=1
        )
        return result.q, result.reached

    def _target(self, T: Matrix) -> Target:
        if self.kind == "pose":
            return Target(T[:3, 3], orientation=T[:3, :3])
        if self.kind == "direction":
            direction = T[:3, :3] @ self._tool_axis
            return Target(T[:3, 3], direction=direction, tool_axis=self._tool_axis)
        return Target(T[:3, 3])
