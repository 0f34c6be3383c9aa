"""The public question: joints for a target."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from ikservo.errors import BadValueError
from ikservo.ik.kernel.layout import FURTHEST_RAD
from ikservo.ik.methods import method_named
from ikservo.ik.options import RESTARTS, Options, Posture, Tolerance
from ikservo.ik.preparing import check_chain
from ikservo.ik.result import Question, Result
from ikservo.ik.target import Target
from ikservo.kinematics import Chain, finite_vector

__all__ = ["solve"]


def solve(
    chain: Chain,
    target: Target,
    q0: ArrayLike | None = None,
    method: str = "auto",
    *,
    tolerance: Tolerance | None = None,
    restarts: int = RESTARTS,
    max_iterations: int | None = None,
    posture: Posture | None = None,
    trace: bool = False,
    position_first: bool | None = None,
    turn_weight_m_rad: float = 0.2,
    track: bool = False,
    nearest: bool = True,
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
        posture: A configuration to lean towards where the target leaves freedom (``auto`` and
            ``pseudo_inverse``; the other methods have no null space and ignore it).
        trace: Whether the result shall carry every iterate.
        position_first: Whether the position is met exactly, and the orientation as well as what
            remains allows; if None for arms with fewer than six joints. Else both are weighed.
        turn_weight_m_rad: How many metres of position error a radian is worth (``bounded``).
        track: Follow a path: one walk from ``q0``, never to another branch (``bounded``).
        nearest: Look for the solution nearest to ``q0`` where there are several (``auto``): among
            those of the closed form where the arm has one, else from some starts around ``q0``.
            ``False`` takes the first that is found, in a twentieth of the time.

    Returns:
        The solution, or the nearest point that was found and the limits that bind there.

    Raises:
        BadValueError: q0 has a wrong shape or is not finite, an option makes no sense, or there is
            no chain or no target.
        UnknownNameError: No such method, or the target's frame is no link of the arm.
    """
    options = Options(
        tolerance or Tolerance(),
        restarts,
        max_iterations,
        posture,
        trace,
        position_first,
        turn_weight_m_rad,
        track,
        nearest,
    )
    check_chain(chain)
    _check_target(target)
    start = chain.middle() if q0 is None else finite_vector(q0, chain.dof, "q0")
    if float(np.abs(start).max()) > FURTHEST_RAD:
        raise BadValueError("q0", start.tolist(), "radians and metres, at most 1e6")
    result = method_named(method)(chain, target, start, options)
    return replace(result, question=Question(chain, target))


def _check_target(target: object) -> None:
    if not isinstance(target, Target):
        raise BadValueError("The target", repr(target), "a Target, as in Target((0.25, 0, 0.15))")
