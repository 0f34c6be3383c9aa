"""Prepare a solve: pack the chain and the options for the kernel, and choose the starts.

Joints that do not influence a target keep their start position: joints between the frame and the
tip, and joints whose axis contains the target point. A search that starts elsewhere, or leaves a
saddle, would move these joints along with the others, and nothing would move them back.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cache
from typing import Literal, cast
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from ikservo.arguments import check_choice, parse_name
from ikservo.errors import BadValueError, shown
from ikservo.ik.problem import Options
from ikservo.kernels.layout import (
    PROBLEM_SIZE,
    RESULT_TAIL,
    SCORE_ROWS,
    SEED_COS_Q1,
    SEED_POSITION,
    SEED_Q1,
    SEED_RADIUS2,
    SEED_ROTATION,
    SEED_SIN_Q1,
    SEED_SIZE,
    work_shape,
)
from ikservo.kinematics import Chain, JointType, pack_chain
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.conditioning import ordinary_postures
from ikservo.kinematics.packed import COLUMN, FIRST_INDEPENDENT, POSITION, ROTATION, rotation_z_to


def prepare_seeds(
    chain: Chain,
    arm: Matrix,
    q: Matrix,
    frame: str | None,
    offset_m: Vector | None,
    R_frame_tool: Matrix,
    *,
    swinging: bool,
) -> Matrix:
    """Return joints (m, dof) as seed columns (dof + SEED_SIZE, m).

    Starts ``q`` (m, dof) are inside the limits. ``R_frame_tool`` (3, 3) rotates from tool to frame
    coordinates. If ``swinging``, the first joint may rotate to bring the tool near the target.
    """
    n, first = chain.dof, int(arm[1, COLUMN])
    half_rad, start = 0.0, q.copy()
    if swinging and arm[0, FIRST_INDEPENDENT] == 1.0:
        middle, half_rad = _half_range(float(chain.lower_rad[first]), float(chain.upper_rad[first]))
        start[:, first] = middle
    T = chain.forward(start, frame, offset_m)
    base = arm[1, ROTATION : ROTATION + 9].reshape(3, 3)
    p = (T[:, :3, 3] - arm[1, POSITION : POSITION + 3]) @ base
    columns = np.zeros((n + SEED_SIZE, len(q)))
    columns[:n], marks = q.T, columns[n:]
    marks[SEED_ROTATION : SEED_ROTATION + 9] = (
        (base.T @ T[:, :3, :3] @ R_frame_tool).reshape(-1, 9).T
    )
    marks[SEED_POSITION : SEED_POSITION + 3], marks[SEED_RADIUS2] = p.T, np.sum(p * p, axis=1)
    marks[SEED_Q1] = start[:, first]
    marks[SEED_COS_Q1], marks[SEED_SIN_Q1] = math.cos(half_rad), math.sin(half_rad)
    return columns


def _half_range(lower_rad: float, upper_rad: float) -> tuple[float, float]:
    """Compute the middle of a joint's range, and half the range's width up to half a revolution."""
    if upper_rad - lower_rad >= 2.0 * math.pi:
        return min(max(0.0, lower_rad + math.pi), upper_rad - math.pi), math.pi
    return 0.5 * (lower_rad + upper_rad), 0.5 * (upper_rad - lower_rad)


def seeds(chain: Chain, count: int) -> Matrix:
    """Return joint vectors (count, dof) that fill the limits evenly, with the middle first.

    The sequence is the same every time, so that results are reproducible.
    """
    low, high = chain.lower_rad.copy(), chain.upper_rad.copy()
    # A range of more than a revolution is filled in the revolution nearest to zero.
    wide = (high - low > math.tau) & [kind is not JointType.PRISMATIC for kind in chain.kinds]
    wide |= ~np.isfinite(low) | ~np.isfinite(high)
    first = np.clip(-math.pi, low[wide], high[wide] - math.tau)
    low[wide], high[wide] = first, first + math.tau
    points = chain.clip(low + (high - low) * quasi_random_points(count, chain.dof))
    points[:1] = chain.mid_range()
    return points


def quasi_random_points(count: int, dimensions: int) -> Matrix:
    """Return points (count, dimensions) that fill the unit cube evenly, without clusters.

    This is the R-sequence of M. Roberts, The unreasonable effectiveness of quasirandom sequences,
    2018: point i is ``frac(½ + i / φ^j)`` in dimension j, where ``φ^(dimensions + 1) = φ + 1``.
    """
    phi = 2.0  # converges to the golden ratio for one dimension, and to its generalisation for more
    for _ in range(64):
        phi = (1.0 + phi) ** (1.0 / (dimensions + 1))
    steps: Vector = phi ** -np.arange(1.0, dimensions + 1)
    return (0.5 + np.outer(np.arange(count), steps)) % 1.0


TargetKindName = Literal["position", "direction", "pose"]

HOMOGENEOUS_ROW = [0.0, 0.0, 0.0, 1.0]
"""The last row of every pose."""

_BUDGET = 60
_EXTRA_RESTARTS = 1
_MAX_PREPARED = 16


class TargetKind(IntEnum):
    """The kind of a target, with the number that the kernels use for it."""

    POSITION = 0
    DIRECTION = 1
    POSE = 2


def check_options(options: object) -> None:
    """Raise BadValueError if the value is not ``Options``."""
    if not isinstance(options, Options):
        raise BadValueError(
            "The value of options", shown(options), "Options, such as Options(restarts=20)"
        )


def check_homogeneous_row(poses: Matrix, what: str) -> None:
    """Raise BadValueError if the last row of a pose (4, 4), or of several, is not 0 0 0 1."""
    if not np.allclose(poses[..., 3, :], HOMOGENEOUS_ROW, rtol=0.0, atol=1e-9):
        raise BadValueError(f"The last row of {what}", "wrong", "[0, 0, 0, 1] (transposed?)")


def target_kind(name: str) -> TargetKind:
    """Return the kind of target with that name.

    Raises:
        UnknownNameError: There is no such kind.
    """
    kinds = [kind.name.lower() for kind in TargetKind]
    lower = name.lower() if isinstance(cast("object", name), str) else name
    return TargetKind[check_choice("kind of target", lower, kinds).upper()]


@cache
def load_kernel() -> Callable[..., int]:
    """Load the search, compiled if possible."""
    from ikservo.kernels.search import solve_all  # noqa: PLC0415  # loads with the first solve

    return solve_all


class SolverBuffers:
    """The work arrays for one solve at a time; each thread needs its own.

    Attributes:
        question: Target positions, then rotations row by row (m, 12).
        start: Start joints (m, dof).
        answer: Results (m, 2 dof + 9), see ``kernels.layout``.
        trace: Iterates (t, dof).
    """

    def __init__(self, dof: int, restarts: int, questions: int = 1, traced: int = 0) -> None:
        self.work: Matrix = np.zeros(work_shape(dof, restarts))
        self.scores: Matrix = np.zeros((SCORE_ROWS, restarts))
        self.question: Matrix = np.zeros((questions, PROBLEM_SIZE))
        self.start: Matrix = np.zeros((questions, dof))
        self.answer: Matrix = np.zeros((questions, 2 * dof + RESULT_TAIL))
        self.trace: Matrix = np.zeros((traced, dof))


# A joint that moves the point or rotates the tool axis by less [m/rad] has no effect. The tip of an
# arm with a calibrated roll is further than this from the roll axis.
_NOTHING = 1e-9


@dataclass(frozen=True, slots=True)
class IdleJoint:
    """A joint that does not influence the target and keeps its position, with the joint's range.

    Attributes:
        column: The joint index in q.
        lower: Lower limit, rad or m.
        upper: Upper limit.
        period: A full revolution; infinite for a prismatic joint.
    """

    column: int
    lower: float
    upper: float
    period: float

    def resting_position(self, start: float) -> float:
        """Return the start, or the equivalent or nearest position inside the limits."""
        if start > self.upper and math.isfinite(self.period):
            equivalent = start - self.period * math.ceil((start - self.upper) / self.period)
            return equivalent if equivalent >= self.lower else self.upper
        if start < self.lower and math.isfinite(self.period):
            equivalent = start + self.period * math.ceil((self.lower - start) / self.period)
            return equivalent if equivalent <= self.upper else self.lower
        return min(max(start, self.lower), self.upper)


def idle_joints(
    chain: Chain,
    frame: str | None,
    offset_m: Vector | None,
    axis: Vector | None,
    *,
    orientation: bool,
) -> tuple[IdleJoint, ...]:
    """Return the joints that change neither the point nor the orientation of a target.

    The point (3,) is on a link, by default the origin of the tip. The target may also include the
    direction of an ``axis`` (3,) of the link, or the whole orientation.
    """
    T, J = chain.forward_and_jacobian(ordinary_postures(chain.dof), frame, offset_m)
    moving = _moving_joints(J[:, :3])
    if orientation:
        moving |= _moving_joints(J[:, 3:])
    elif axis is not None:
        pointing = (T[:, :3, :3] @ axis)[:, :, None]
        moving |= _moving_joints(np.cross(J[:, 3:], pointing, axis=1))
    idle: list[IdleJoint] = []
    for column in np.flatnonzero(~moving).tolist():
        period = math.inf if chain.kinds[column] is JointType.PRISMATIC else math.tau
        lower, upper = float(chain.lower_rad[column]), float(chain.upper_rad[column])
        idle.append(IdleJoint(column, lower, upper, period))
    return tuple(idle)


def _moving_joints(rows: Vector) -> NDArray[np.bool_]:
    """Return a mask (dof,) of the joints whose column is not zero in rows (samples, 3, dof)."""
    return np.abs(rows).max(axis=(0, 1)) > _NOTHING


@dataclass(frozen=True, slots=True, eq=False)
class PackedProblem:
    """An arm and one point of it, packed for the kernels.

    A problem must not refer to its chain, because the chain is its key in the cache; otherwise
    neither would ever be freed.

    Attributes:
        arm: The packed chain.
        seeds: Starting points (dof + SEED_SIZE, m) in addition to those of the caller.
        idle: The joints that keep their position, by the kind of target.
    """

    frame: str | None
    offset_m: Vector | None
    tool_axis: Vector | None
    arm: Matrix
    seeds: Matrix
    idle: Mapping[TargetKind, tuple[IdleJoint, ...]]

    def make_seeds(self, chain: Chain, q: Matrix, *, swinging: bool = True) -> Matrix:
        """Convert joints (m, dof) to seeds (dof + SEED_SIZE, m), see ``kernels.layout``."""
        R_frame_tool = np.eye(3) if self.tool_axis is None else rotation_z_to(self.tool_axis)
        return prepare_seeds(
            chain, self.arm, q, self.frame, self.offset_m, R_frame_tool, swinging=swinging
        )


def pack_problem(
    chain: Chain,
    frame: str | None,
    offset_m: Vector | None,
    tool_axis: Vector | None,
    restarts: int,
) -> PackedProblem:
    """Pack the arm for a number of starting points; the most recent results are cached."""
    frame = None if frame is None else parse_name("The frame", frame)
    key = (frame, _array_bytes(offset_m), _array_bytes(tool_axis))
    kept = _prepared.setdefault(chain, {})
    ready = kept.get(key)
    if ready is None:
        while len(kept) >= _MAX_PREPARED:
            kept.pop(next(iter(kept)), None)
        arm, none = pack_chain(chain, frame, offset_m, tool_axis), np.zeros((0, 0))
        point = chain, frame, offset_m
        idle = {
            TargetKind.POSITION: idle_joints(*point, None, orientation=False),
            TargetKind.DIRECTION: idle_joints(*point, tool_axis, orientation=False),
            TargetKind.POSE: idle_joints(*point, None, orientation=True),
        }
        ready = kept[key] = PackedProblem(frame, offset_m, tool_axis, arm, none, idle)
    if ready.seeds.shape[1] < restarts - 1:
        more = ready.make_seeds(chain, seeds(chain, restarts - 1))
        ready = kept[key] = replace(ready, seeds=more)
    return ready


def pack_settings(kind: TargetKind, dof: int, options: Options) -> Vector:
    """Compute the settings of a search as the kernels read them, see ``kernels.layout``."""
    tolerance = options.tolerance
    return np.array(
        [
            float(kind),
            tolerance.position_m,
            2.0 * math.sin(0.5 * min(tolerance.orientation_rad, math.pi)),
            options.turn_weight_m_rad,
            float(options.puts_position_first(dof)),
            float(options.track),
            1.0 if options.track else float(options.restarts),
            float(_EXTRA_RESTARTS),
            float(options.max_iterations or _BUDGET),
        ]
    )


def _array_bytes(vector: Vector | None) -> bytes:
    return b"" if vector is None else vector.tobytes()


_prepared: WeakKeyDictionary[Chain, dict[tuple[str | None, bytes, bytes], PackedProblem]] = (
    WeakKeyDictionary()
)
