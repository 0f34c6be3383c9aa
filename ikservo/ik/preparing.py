"""A question made ready for the kernels: the arm packed, the rules written, the memory taken."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cache
from typing import Literal
from weakref import WeakKeyDictionary

import numpy as np

from ikservo.errors import BadValueError, UnknownNameError
from ikservo.ik.idle import IdleJoint, idle_joints
from ikservo.ik.marks import marked
from ikservo.ik.options import Options
from ikservo.ik.seeds import seeds
from ikservo.kinematics import Chain, pack
from ikservo.kinematics.packing import turn_z_onto
from ikservo.kinematics.se3 import Matrix, Vector

__all__ = [
    "BOTTOM",
    "Kind",
    "KindName",
    "Prepared",
    "Worker",
    "check_bottom",
    "check_chain",
    "check_options",
    "kernel",
    "kind_named",
    "prepared",
    "settings_of",
]

KindName = Literal["position", "direction", "pose"]

BOTTOM = [0.0, 0.0, 0.0, 1.0]
"""The last row of every pose."""

_BUDGET = 60
_EXTRA_RESTARTS = 1
_KEPT = 16


class Kind(IntEnum):
    """What a target asks for; the numbers are the kernels'."""

    POSITION = 0
    DIRECTION = 1
    POSE = 2


def check_chain(chain: object) -> None:
    """Raise BadValueError where something else is given for a chain."""
    if not isinstance(chain, Chain):
        raise BadValueError("The chain", repr(chain), 'a Chain, as in load_model("so101").chain')


def check_options(options: object) -> None:
    """Raise BadValueError where something else is given for options."""
    if not isinstance(options, Options):
        raise BadValueError("The options", repr(options), "Options, as in Options(restarts=20)")


def check_bottom(poses: Matrix, what: str) -> None:
    """Raise BadValueError where the last row of a pose (4, 4), or of many, is not 0 0 0 1."""
    if not np.allclose(poses[..., 3, :], BOTTOM, rtol=0.0, atol=1e-9):
        raise BadValueError(f"The last row of {what}", "another", "[0, 0, 0, 1]: is it transposed?")


def kind_named(name: str) -> Kind:
    """Return the kind of target of that name.

    Raises:
        UnknownNameError: There is none.
    """
    if str(name).upper() not in Kind.__members__:
        raise UnknownNameError("kind of target", name, [kind.name.lower() for kind in Kind])
    return Kind[name.upper()]


@cache
def kernel() -> Callable[..., int]:
    """Return the compiled search; numba is imported here and nowhere before."""
    from ikservo.ik.kernel.searching import search_all  # noqa: PLC0415  # see above

    return search_all


class Worker:
    """The memory in which one question at a time is worked on; one for each thread.

    Attributes:
        question: (m, 12) wanted position, then rotation row by row.
        start: (m, dof) where to start.
        answer: (m, 2 dof + 9), see ``kernel.layout``.
        trace: (t, dof) iterates.
    """

    def __init__(self, dof: int, restarts: int, questions: int = 1, traced: int = 0) -> None:
        from ikservo.ik.kernel.desk import desk_shape  # noqa: PLC0415  # imports nothing
        from ikservo.ik.kernel.layout import ANSWER_TAIL, QUESTION_SIZE  # noqa: PLC0415

        self.desk: Matrix = np.zeros(desk_shape(dof, restarts))
        self.question: Matrix = np.zeros((questions, QUESTION_SIZE))
        self.start: Matrix = np.zeros((questions, dof))
        self.answer: Matrix = np.zeros((questions, 2 * dof + ANSWER_TAIL))
        self.trace: Matrix = np.zeros((traced, dof))


@dataclass(frozen=True, slots=True, eq=False)
class Prepared:
    """An arm with one point of it, as the kernels read them.

    It must not hold the chain, which is the key that it is kept under: neither would ever go.

    Attributes:
        arm: The packed chain.
        seeds: Starting points beside the caller's (dof + SEED_SIZE, m).
        idle: The joints that stay where they are, by the kind of target.
    """

    frame: str | None
    offset_m: Vector | None
    tool_axis: Vector | None
    arm: Matrix
    seeds: Matrix
    idle: Mapping[Kind, tuple[IdleJoint, ...]]

    def marked(self, chain: Chain, q: Matrix, *, swinging: bool = True) -> Matrix:
        """Return joints (m, dof) as seeds (dof + SEED_SIZE, m), see ``kernel.layout``."""
        turn = np.eye(3) if self.tool_axis is None else turn_z_onto(self.tool_axis)
        return marked(chain, self.arm, q, self.frame, self.offset_m, turn, swinging=swinging)


def prepared(
    chain: Chain,
    frame: str | None,
    offset_m: Vector | None,
    tool_axis: Vector | None,
    restarts: int,
) -> Prepared:
    """Return the arm made ready for so many starting points; the last few are kept."""
    key = (None if frame is None else str(frame), _bytes(offset_m), _bytes(tool_axis))
    kept = _prepared.setdefault(chain, {})
    ready = kept.get(key)
    if ready is None:
        while len(kept) >= _KEPT:
            kept.pop(next(iter(kept)), None)
        arm, none = pack(chain, frame, offset_m, tool_axis), np.zeros((0, 0))
        idle = _idle(chain, frame, offset_m, tool_axis)
        ready = kept[key] = Prepared(frame, offset_m, tool_axis, arm, none, idle)
    if ready.seeds.shape[1] < restarts - 1:
        more = ready.marked(chain, seeds(chain, restarts - 1))
        ready = kept[key] = replace(ready, seeds=more)
    return ready


def _idle(
    chain: Chain, frame: str | None, offset_m: Vector | None, tool_axis: Vector | None
) -> Mapping[Kind, tuple[IdleJoint, ...]]:
    return {
        Kind.POSITION: idle_joints(chain, frame, offset_m, None, whole=False),
        Kind.DIRECTION: idle_joints(chain, frame, offset_m, tool_axis, whole=False),
        Kind.POSE: idle_joints(chain, frame, offset_m, None, whole=True),
    }


def settings_of(kind: Kind, dof: int, options: Options) -> Vector:
    """Return the rules of a search as the kernels read them, see ``kernel.layout``."""
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


def _bytes(vector: Vector | None) -> bytes:
    return b"" if vector is None else vector.tobytes()


_prepared: WeakKeyDictionary[Chain, dict[tuple[str | None, bytes, bytes], Prepared]] = (
    WeakKeyDictionary()
)
