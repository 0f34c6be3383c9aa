"""Chains and collision bodies as flat arrays for the compiled kernels.

Row 0 is a header, followed by one row per moving joint, one for the tool, one per limit. Fixed
joints are folded into their neighbours, and every joint frame is rotated so that its axis is z,
because a rotation then mixes just two columns of the pose.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.capsules import Capsule
from ikservo.kinematics.chain import Chain
from ikservo.kinematics.joints import ChainJoint, JointType
from ikservo.kinematics.se3 import make_pose, skew

WIDTH = 17
# fmt: off
STEPS, DOF, FIRST_INDEPENDENT = 0, 1, 2  # header: number of joint rows and limit rows; 1 if q of
          # the first joint rotates it, and nothing else
ROTATION, POSITION       = 0, 9          # joint and tool: R row by row (9), then p (3)
IS_REVOLUTE, COLUMN = 12, 13  # joint: 1 revolute, 0 prismatic; the entry of q that moves it
SCALE, SHIFT             = 14, 15        # joint: value = SCALE * q[COLUMN] + SHIFT
IS_ALIGNED               = 16            # joint and tool: 1 if R is exactly the identity
LOWER, UPPER, FULL_TURN  = 0, 1, 2       # limit: the range; 1 if every angle is inside the range
# fmt: on

# A range from -3.14 to 3.14 in a file means a full revolution.
_FULL_TURN_RAD = 2.0 * math.pi - 1e-2


def pack_chain(
    chain: Chain,
    frame: str | None = None,
    offset_m: Vector | None = None,
    tool_axis: Vector | None = None,
) -> Matrix:
    """Pack the joints to a point of a link into one array (2 + joints + dof, WIDTH).

    Args:
        chain: The arm.
        frame: Name of a link; the tip if None.
        offset_m: A point (3,) in that link's coordinates, metres; the link's origin if None.
        tool_axis: A unit vector (3,) in that link's coordinates, to which z of the packed tool is
            aligned; None uses the link's own z.

    Raises:
        UnknownNameError: There is no link named ``frame``.
    """
    path = chain.joints_to(frame)
    rows, rest = _joint_rows(path)
    if offset_m is not None:
        rest = rest @ make_pose(offset_m)
    if tool_axis is not None:
        rest = rest @ make_pose(np.zeros(3), rotation_z_to(tool_axis))
    header = np.zeros(WIDTH)
    header[STEPS], header[DOF] = len(rows), chain.dof
    if rows:
        first = rows[0]
        plain = first[IS_REVOLUTE] == 1.0 and first[SCALE] == 1.0 and first[SHIFT] == 0.0
        header[FIRST_INDEPENDENT] = bool(plain) and not _has_mimics(chain, int(first[COLUMN]))
    return np.array([header, *rows, _flatten_pose(rest), *_limit_rows(chain)])


def rotation_z_to(axis: Vector) -> Matrix:
    """Compute a rotation (3, 3) whose third column is the unit vector ``axis`` (3,)."""
    z = np.asarray(axis, dtype=np.float64)
    helper = np.eye(3)[0 if abs(z[0]) < 0.9 else 1]
    y = skew(z) @ helper
    y /= math.sqrt(float(y @ y))
    return np.array([skew(y) @ z, y, z]).T


def _joint_rows(path: tuple[ChainJoint, ...]) -> tuple[list[Vector], Matrix]:
    """Compute a row for each joint that q moves, and the fixed pose (4, 4) after the last joint."""
    rows: list[Vector] = []
    rest = make_pose(np.zeros(3))
    for step in path:
        rest = rest @ step.joint.origin
        if not step.scale or step.joint.kind is JointType.FIXED:
            rest = rest @ step.motion_at(step.shift)
            continue
        align = rotation_z_to(step.joint.axis)
        row = _flatten_pose(rest @ make_pose(np.zeros(3), align))
        row[IS_REVOLUTE] = step.joint.kind is JointType.REVOLUTE
        row[COLUMN], row[SCALE], row[SHIFT] = step.column, step.scale, step.shift
        rows.append(row)
        rest = make_pose(np.zeros(3), align.T)
    return rows, rest


def _flatten_pose(T: Matrix) -> Vector:
    row = np.zeros(WIDTH)
    row[ROTATION : ROTATION + 9] = T[:3, :3].ravel()
    row[POSITION : POSITION + 3] = T[:3, 3]
    row[IS_ALIGNED] = np.array_equal(T[:3, :3], np.eye(3))
    return row


def _limit_rows(chain: Chain) -> list[Vector]:
    rows: list[Vector] = []
    for i, kind in enumerate(chain.kinds):
        row = np.zeros(WIDTH)
        row[LOWER], row[UPPER] = chain.lower_rad[i], chain.upper_rad[i]
        wide = chain.upper_rad[i] - chain.lower_rad[i] >= _FULL_TURN_RAD
        row[FULL_TURN] = wide and kind is JointType.REVOLUTE and not _has_mimics(chain, i)
        rows.append(row)
    return rows


def _has_mimics(chain: Chain, column: int) -> bool:
    """Check whether other joints mimic this one, so that a full revolution changes the pose."""
    followers = {
        step.joint.name
        for frame in chain.frames
        for step in chain.joints_to(frame)
        if step.scale and step.column == column and step.joint.mimic is not None
    }
    return bool(followers)


# fmt: off
ORIGIN, LINK_POSE, AXIS = 0, 9, 12  # link: R row by row (9), p (3); axis (3)
# link: value = MIMIC_SCALE * q[MIMIC_COLUMN] + MIMIC_OFFSET
PARENT, IS_PRISMATIC, MIMIC_COLUMN, MIMIC_SCALE, MIMIC_OFFSET = 15, 16, 17, 18, 19
START, END, RADIUS, LINK             = 0, 3, 6, 7          # capsule: both ends (3), in its link
LINK_WIDTH, CAPSULE_WIDTH            = 20, 8
# shape: R row by row (9), centre (3), half extents (3) of a box, or the radius and, third, half the
# length of a cylinder about its z; both are enlarged by ROUNDING, which turns a point into a sphere
CENTRE, HALF, ROUNDING, IS_CYLINDER, SHAPE_WIDTH = 9, 12, 15, 16, 17
# fmt: on


@dataclass(frozen=True, slots=True, eq=False)
class PackedBody:
    """The links and capsules of an arm, and the pairs to compare.

    Attributes:
        base: The name of the fixed link.
        dof: The length of a joint vector.
        names: The links, parents first.
        links: One row per link (links, 20).
        capsules: One row per capsule (capsules, 8).
        pairs: The names of the pairs.
        rows: Two capsules and their pair (m, 3).
        overlap_m: The allowed overlap of each pair (pairs,).
        reach_m: Maximum motion of a point of each link's capsules (links, dof) per unit of a joint,
            m/rad or m/m.
        pair_reach_m: Maximum approach of each pair (pairs, dof) per unit of a joint, m/rad or m/m.
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
    rows = np.zeros((len(names), LINK_WIDTH))
    for row, name in zip(rows, names, strict=True):
        path = chain.joints_to(name)
        row[PARENT] = names.index(path[-1].joint.parent) if path else -1
        if not path:
            continue
        step, joint = path[-1], path[-1].joint
        row[ORIGIN : ORIGIN + 9] = joint.origin[:3, :3].ravel()
        row[LINK_POSE : LINK_POSE + 3] = joint.origin[:3, 3]
        if joint.kind is JointType.FIXED:
            continue
        row[AXIS : AXIS + 3] = joint.axis
        row[IS_PRISMATIC] = joint.kind is JointType.PRISMATIC
        row[MIMIC_COLUMN], row[MIMIC_SCALE], row[MIMIC_OFFSET] = step.column, step.scale, step.shift
    return names, rows


def pack_capsules(capsules: Sequence[Capsule], links: Sequence[str]) -> Matrix:
    """Compute a row for each capsule (n, 8)."""
    rows = [[*c.start_m, *c.end_m, c.radius_m, links.index(c.link)] for c in capsules]
    return np.array(rows, dtype=np.float64).reshape(len(rows), CAPSULE_WIDTH)
