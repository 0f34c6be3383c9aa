"""Solve many targets at once, on several threads."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ikservo.errors import BadValueError
from ikservo.ik.prepare import (
    SolverBuffers,
    TargetKind,
    TargetKindName,
    check_homogeneous_row,
    check_options,
    load_kernel,
    pack_problem,
    pack_settings,
    target_kind,
)
from ikservo.ik.problem import (
    ArmLike,
    Options,
    chain_and_start,
    check_count,
    check_position,
    normalise,
)
from ikservo.kernels.layout import (
    ITERATIONS,
    MAX_ANGLE_RAD,
    MAX_POSITION_M,
    POSITION_ERROR,
    REACHED,
    ROTATION_ERROR,
)
from ikservo.kinematics import Chain, finite_array
from ikservo.kinematics.arrays import FrozenArrays, Matrix, Vector, as_floats

# Targets per task: enough that distribution costs nothing, few enough that all cores end together.
_CHUNK = 256


@dataclass(frozen=True, slots=True, eq=False)
class BatchResult(FrozenArrays):
    """The results of m targets, row by row.

    Attributes:
        q: Joints (m, dof), rad or m, always inside the limits.
        reached: Whether position and orientation are within the tolerance (m,).
        position_error_m: Distance from the target point (m,).
        orientation_error_rad: Angle from the target direction or orientation (m,); 0 if only the
            position counts.
        iterations: Number of steps, including restarts (m,).
    """

    q: Matrix
    reached: NDArray[np.bool_]
    position_error_m: Vector
    orientation_error_rad: Vector
    iterations: NDArray[np.int64]


def solve_batch(
    chain: ArmLike,
    targets: ArrayLike,
    q0s: ArrayLike | None = None,
    workers: int | None = None,
    *,
    kind: TargetKindName | None = None,
    tool_axis: ArrayLike = (0.0, 0.0, 1.0),
    frame: str | None = None,
    offset_m: ArrayLike | None = None,
    options: Options | None = None,
) -> BatchResult:
    """Solve m targets with ``bounded``, each from its own start; their order does not matter.

    An arm that sags under its weight is treated as if it were rigid.

    Args:
        chain: The arm, or its model, its name, or the path of its file.
        targets: Points (m, 3) in metres, or poses T_world_tool (m, 4, 4).
        q0s: Starts (m, dof), or one start for all (dof,). None uses ``initial_joints()`` of a
            model, or the middle of the ranges of a chain.
        workers: The number of threads; None uses the number of cores.
        kind: The part of the poses that counts: ``position``, ``direction`` or ``pose``; None
            means ``pose``.
        tool_axis: The axis (3,) in the frame's coordinates for ``direction``.
        frame: The link to move to the target; the tip if None.
        offset_m: The point (3,) on that link, metres; the link's origin if None.
        options: Tolerance and limits of the search.

    Raises:
        BadValueError: A shape or a rotation is not valid, or a number is not finite.
        UnknownNameError: There is no such kind or frame.
    """
    chain, q0s = chain_and_start(chain, q0s)
    if workers is not None:
        check_count("workers", workers)
    options = Options() if options is None else options
    check_options(options)
    questions, kind_code = _problem_rows(targets, kind, normalise(tool_axis, "tool_axis"))
    starts = _start_rows(chain, q0s, len(questions))
    offset = None if offset_m is None else check_position(offset_m, "offset_m")
    axis = normalise(tool_axis, "tool_axis") if kind_code is TargetKind.DIRECTION else None
    ready = pack_problem(chain.rigid, frame, offset, axis, options.restarts)
    settings = pack_settings(kind_code, chain.dof, options)
    answers = SolverBuffers(chain.dof, options.restarts, len(questions)).answer
    search = load_kernel()

    def work(first: int) -> int:
        rows = slice(first, first + _CHUNK)
        own = SolverBuffers(chain.dof, options.restarts, 0)
        bad = search(
            ready.arm,
            questions[rows],
            settings,
            starts[rows],
            ready.seeds,
            own.work,
            own.scores,
            own.trace,
            answers[rows],
        )
        return -1 if bad < 0 else first + bad

    with ThreadPoolExecutor(workers or os.cpu_count()) as pool:
        wrong = [bad for bad in pool.map(work, range(0, len(questions), _CHUNK)) if bad >= 0]
    if wrong:
        raise BadValueError(f"The rotation of target {wrong[0]}", "invalid", "R Rᵀ = 1, det R = 1")
    for joint in ready.idle[kind_code]:
        stay = [joint.resting_position(start) for start in starts[:, joint.column].tolist()]
        answers[:, joint.column] = stay
    tail = answers[:, 2 * chain.dof :]
    return BatchResult(
        q=answers[:, : chain.dof].copy(),
        reached=tail[:, REACHED] == 1.0,
        position_error_m=tail[:, POSITION_ERROR].copy(),
        orientation_error_rad=tail[:, ROTATION_ERROR].copy(),
        iterations=tail[:, ITERATIONS].astype(np.int64),
    )


def _problem_rows(
    targets: ArrayLike, kind: TargetKindName | None, axis: Vector
) -> tuple[Matrix, TargetKind]:
    """Compute the kernels' target rows (m, 12), and the kind of target."""
    array = as_floats(targets, "targets", "numbers of shape (m, 3) or (m, 4, 4)")
    count = len(array) if array.ndim else 0
    questions = np.zeros((count, 12))
    if array.ndim == 2 and kind in (None, "position"):
        questions[:, :3] = _check_positions(finite_array(array, (count, 3), "targets"))
        return questions, TargetKind.POSITION
    poses = finite_array(array, (count, 4, 4), "targets")
    check_homogeneous_row(poses, "a target")
    _check_positions(poses[:, :3, 3])
    kind_code = TargetKind.POSE if kind is None else target_kind(kind)
    questions[:, :3] = poses[:, :3, 3]
    if kind_code is TargetKind.POSE:
        questions[:, 3:] = poses[:, :3, :3].reshape(-1, 9)
    elif kind_code is TargetKind.DIRECTION:
        questions[:, 5::3] = poses[:, :3, :3] @ axis
    return questions, kind_code


def _check_positions(points_m: Matrix) -> Matrix:
    if points_m.size and float(np.abs(points_m).max()) > MAX_POSITION_M:
        raise BadValueError("A target", f"{np.abs(points_m).max():g} m away", "at most 1 km")
    return points_m


def _start_rows(chain: Chain, q0s: ArrayLike | None, count: int) -> Matrix:
    if q0s is None:
        starts = np.tile(chain.mid_range(), (count, 1))
    else:
        given = as_floats(q0s, "q0s", "numbers of shape (m, dof) or (dof,)")
        shape = (chain.dof,) if given.ndim == 1 else (count, chain.dof)
        starts = np.broadcast_to(finite_array(given, shape, "q0s"), (count, chain.dof))
    if starts.size and float(np.abs(starts).max()) > MAX_ANGLE_RAD:
        raise BadValueError(
            "A start", f"{np.abs(starts).max():g}", "radians or metres, at most 1e6"
        )
    return np.array(starts, order="C")
