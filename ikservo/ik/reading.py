"""What the kernels wrote down, read as a result."""

from __future__ import annotations

from ikservo.ik.kernel.layout import GAP, ITERATIONS, NEAREST, REACHED, TURN
from ikservo.ik.result import Binding, Result
from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Vector

__all__ = ["result_of"]


def result_of(chain: Chain, answer: Vector, method: str) -> Result:
    """Return the result that one row of answers (2 dof + ANSWER_TAIL,) means."""
    n = chain.dof
    tail: list[float] = answer[2 * n :].tolist()
    reached = tail[REACHED] == 1.0
    return Result(
        q=answer[:n].copy(),
        reached=reached,
        position_error_m=tail[GAP],
        orientation_error_rad=tail[TURN],
        binding=() if reached else _binding(chain, answer[n : 2 * n].tolist()),
        iterations=int(tail[ITERATIONS]),
        nearest_m=answer[2 * n + NEAREST : 2 * n + NEAREST + 3].copy(),
        method=method,
    )


def _binding(chain: Chain, held: list[float]) -> tuple[Binding, ...]:
    """Name the limits that the search pressed against to the end."""
    return tuple(
        Binding(name, "lower" if side < 0.0 else "upper")
        for name, side in zip(chain.names, held, strict=True)
        if side
    )
