"""``solve``: one target with a method chosen by name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, lru_cache
from importlib import import_module
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from ikservo.arguments import check_choice
from ikservo.ik.bounded import bounded
from ikservo.ik.problem import (
    DEFAULT_RESTARTS,
    ArmLike,
    Options,
    Posture,
    Target,
    Tolerance,
    chain_and_start,
)
from ikservo.ik.result import Result, SolutionSet, SolvedProblem, is_closer
from ikservo.kernels.layout import MAX_ANGLE_RAD
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Vector, bounded_vector

Method = Callable[[Chain, Target, Vector, Options], Result]
"""Takes chain, target, start (dof,) and options; only the start may be outside the limits."""

METHODS = ("bounded", "closed_form", "pseudo_inverse", "transpose", "ccd")
"""Names of the methods; the modules of all but the first are imported when first used."""

_MODULES = {
    "closed_form": "closed_form",
    "pseudo_inverse": "jacobian_methods",
    "transpose": "jacobian_methods",
    "ccd": "ccd",
}


def auto(chain: Chain, target: Target, q0: Vector, options: Options) -> Result:
    """Run ``bounded``, which is compiled; if it fails, also try the closed form.

    The solution is replaced if one that is nearer to the start is known or found. With a posture,
    ``pseudo_inverse`` continues from the solution.

    A search that may not restart or leave its branch uses ``bounded`` alone.
    """
    found = bounded(chain, target, q0, options)
    if found.reached and options.posture is not None and not options.track:
        leaning = get_method("pseudo_inverse")(chain, target, found.q, options)
        return leaning if leaning.reached else found
    alone = options.track or options.restarts == 1
    if alone:
        return found
    from ikservo.ik.closed_form_structure import recognise_structure  # noqa: PLC0415
    from ikservo.ik.other_solutions import nearest_solution  # noqa: PLC0415

    if found.reached and options.nearest:
        return nearest_solution(chain, target, q0, options, found)
    if found.reached or recognise_structure(chain, target.frame) is None:
        return found
    formula = get_method("closed_form")(chain, target, q0, options)
    return formula if is_closer(formula, found, options.tolerance) else found


def get_method(name: str) -> Method:
    """Get the method of that name; ``auto`` selects by arm and result.

    Raises:
        UnknownNameError: There is no such method; existing methods are listed.
    """
    if check_choice("method", name, ("auto", *METHODS)) == "auto":
        return auto
    if name == "bounded":
        return bounded
    return _import_method(name)


@cache
def _import_method(name: str) -> Method:
    return getattr(import_module(f"ikservo.ik.{_MODULES[name]}"), name)


def solve(
    chain: ArmLike,
    target: Target | ArrayLike,
    q0: ArrayLike | None = None,
    method: str = "auto",
    *,
    tolerance: Tolerance | None = None,
    restarts: int = DEFAULT_RESTARTS,
    max_iterations: int | None = None,
    posture: Posture | None = None,
    trace: bool = False,
    position_first: bool | None = None,
    turn_weight_m_rad: float = 0.2,
    track: bool = False,
    nearest: bool = True,
) -> Result:
    """Find joints inside the limits that bring the point to the target.

    With fewer than six joints the position comes first: it is met exactly if the limits allow, and
    the orientation as well as possible after that.

    Args:
        chain: The arm, or its model, its name, or the path of its file; the result is never outside
            its limits, not even by one ulp.
        target: The target, or a point (3,) for the tip, metres.
        q0: The start (dof,), rad or m; may be outside the limits. None uses ``initial_joints()`` of
            the model, where ``ikservo solve`` begins, or the middle of the ranges of a chain, which
            has no poses.
        method: ``auto`` or one of ``METHODS``.
        tolerance: The maximum errors with which the target counts as reached.
        restarts: Maximum number of starting points, the given start first.
        max_iterations: Maximum steps from one start; None uses the method's default.
        posture: A preferred configuration if the target leaves freedom (``auto`` and
            ``pseudo_inverse``; the other methods have no null space and ignore it).
        trace: Whether the result contains every iterate.
        position_first: Whether the position is met exactly and the orientation as well as possible
            after that, instead of weighing both; None: only if the arm has fewer than six joints.
        turn_weight_m_rad: Position error in metres that counts as much as one radian (``bounded``).
        track: Whether to use one start, and never to pass a limit or change branch (``bounded``).
        nearest: Whether to search for the solution nearest to ``q0`` if there are several
            (``auto``): in closed form if the arm has one, otherwise from some starts around ``q0``.
            ``False`` returns the first solution found, in a twentieth of the time.

    Returns:
        The solution, or the nearest posture that was found and its active limits.

    Raises:
        BadValueError: q0 has a wrong shape or is not finite, an option is not valid, or the arm or
            the target is missing.
        UnknownNameError: There is no such arm or method, or the target's frame is not a link of the
            arm.
    """
    values = (
        tolerance,
        restarts,
        max_iterations,
        posture,
        trace,
        position_first,
        turn_weight_m_rad,
        track,
        nearest,
    )
    try:
        options = _checked_options(*values)
    except TypeError:  # an unhashable value, which no option accepts
        options = _make_options(*values)
    if not isinstance(chain, Chain):
        chain, q0 = chain_and_start(chain, q0)
    if not isinstance(target, Target):
        target = Target(target)
    expected = "radians and metres, at most 1e6"
    start = chain.mid_range() if q0 is None else q0
    start = bounded_vector(start, chain.dof, MAX_ANGLE_RAD, "q0", expected)
    run, rigid = get_method(method), chain.rigid
    result = run(rigid, target, start, options)
    if chain.link_joints is not None:
        target, result = _solve_drooping(chain, target, options, run, result)
    return result.attach_question(SolvedProblem(rigid, target, _find_solutions))


def _find_solutions(chain: Chain, target: Target, q: Vector) -> SolutionSet:
    from ikservo.ik.other_solutions import solution_set  # noqa: PLC0415

    return solution_set(chain, target, q)


def _solve_drooping(
    chain: Chain, target: Target, options: Options, run: Method, result: Result
) -> tuple[Target, Result]:
    """Return the raised target that a rigid arm must be given, and the solution for it."""
    from ikservo.ik.droop import Droop  # noqa: PLC0415  # few arms need it

    droop, aimed, asked = Droop(chain, target.frame, target.offset_m), target, options
    for _ in range(droop.max_steps):
        if not droop.follow(result.q):
            break
        aimed = droop.raised(target)
        result = run(chain.rigid, aimed, result.q, asked)
        asked = replace(options, nearest=False, restarts=1) if result.reached else options
    else:
        droop.follow(result.q)
        result = replace(result, reached=result.reached and droop.is_steady)
    return aimed, replace(result, nearest_m=droop.lowered(result.nearest_m))


_TOLERANCE = Tolerance()


def _make_options(tolerance: Tolerance | None, *others: object) -> Options:
    make = cast("Callable[..., Options]", Options)  # checks each of them
    return make(_TOLERANCE if tolerance is None else tolerance, *others)


# Options that were checked in an earlier call; typed, because 1 is not True.
_checked_options = lru_cache(32, typed=True)(_make_options)

_MM_PER_M = 1000.0
_FAR_M = 10.0  # further than any arm with servos can reach


def in_millimetres(chain: Chain, position_m: Sequence[float]) -> str:
    """Return a point (3,) as ``250mm 50mm 150mm`` if the arm reaches it in millimetres, else ''."""
    point = np.asarray(position_m, dtype=float)
    if float(np.abs(point).max()) < _FAR_M:
        return ""
    reached = solve(chain, Target(point / _MM_PER_M)).reached
    return " ".join(f"{x:g}mm" for x in point) if reached else ""
