"""An arm's body as arrays of numbers, as compiled code reads it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ikservo.kinematics.capsules import Capsule
from ikservo.kinematics.chain import Chain
from ikservo.kinematics.joints import JointKind
from ikservo.kinematics.se3 import Matrix, Vector
from ikservo.kinematics.steps import Step

__all__ = [
    "AXIS",
    "COLUMN",
    "END",
    "LINK",
    "ORIGIN",
    "PARENT",
    "PLACE",
    "RADIUS",
    "SCALE",
    "SHIFT",
    "SLIDES",
    "START",
    "PackedBody",
    "pack_capsules",
    "pack_links",
]

# fmt: off
ORIGIN, PLACE, AXIS                  = 0, 9, 12            # link: R row by row (9), p (3); axis (3)
PARENT, SLIDES, COLUMN, SCALE, SHIFT = 15, 16, 17, 18, 19  # link: value = SCALE * q[COLUMN] + SHIFT
START, END, RADIUS, LINK             = 0, 3, 6, 7          # capsule: both ends (3), in its link
# fmt: on


@dataclass(frozen=True, slots=True, eq=False)
class PackedBody:
    """The links and capsules of an arm, and which of them to compare.

    Attributes:
        base: The name of the link that stands still.
        dof: The length of a joint vector.
        names: The links, parents first.
        links: A row for each (links, 20).
        capsules: A row for each (capsules, 8).
        pairs: What comes near what.
        rows: Two capsules and their pair (m, 3).
        overlap_m: By how much each pair may overlap (pairs,).
        reach_m: By how much a point of each link's capsules moves at most (links, dof) for each
            unit of a joint, m/rad or m/m.
        pair_reach_m: By how much each pair may come nearer (pairs, dof), likewise.
    """

    base: str
    dof: int
    names: tuple[str, ...]
    links: Matrix
    capsules: Matrix
    pairs: tuple[tuple[str, str], ...]
    rows: Matrix
    overlap_m: Vector
    reach_m: Matrix
    pair_reach_m: Matrix


def pack_links(chain: Chain) -> tuple[tuple[str, ...], Matrix]:
    """Return the names of all links, parents first, and a row for each (links, 20)."""
    names = chain.frames
    rows = np.zeros((len(names), 20))
    for row, name in zip(rows, names, strict=True):
        way = chain.way(name)
        row[PARENT] = names.index(way[-1].joint.parent) if way else -1
        if way:
            _fill(row, way[-1])
    return names, rows


def pack_capsules(capsules: Sequence[Capsule], links: Sequence[str]) -> Matrix:
    """Return a row for each capsule (n, 8)."""
    rows = [[*c.start_m, *c.end_m, c.radius_m, links.index(c.link)] for c in capsules]
    return np.array(rows, dtype=np.float64).reshape(len(rows), 8)


def _fill(row: Matrix, step: Step) -> None:
    joint = step.joint
    row[ORIGIN : ORIGIN + 9] = joint.origin[:3, :3].ravel()
    row[PLACE : PLACE + 3] = joint.origin[:3, 3]
    if joint.kind is JointKind.FIXED:
        return
    row[AXIS : AXIS + 3] = joint.axis
    row[SLIDES] = joint.kind is JointKind.PRISMATIC
    row[COLUMN], row[SCALE], row[SHIFT] = step.column, step.scale, step.shift
