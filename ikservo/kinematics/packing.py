"""The way to one point of an arm as a single array of numbers, as compiled code reads it.

Row 0 is a header, then comes one row a moving joint, one for the tool, one a limit. Fixed joints
are folded into their neighbours, and every joint frame is turned so that its axis is z: then a
turn mixes two columns of the pose, and nothing else.
"""

from __future__ import annotations

import math

import numpy as np

from ikservo.kinematics.chain import Chain
from ikservo.kinematics.joints import JointKind
from ikservo.kinematics.se3 import Matrix, Vector, pose, skew
from ikservo.kinematics.steps import Step

__all__ = [
    "COLUMN",
    "DOF",
    "FULL_TURN",
    "LOWER",
    "POSITION",
    "ROTATION",
    "SCALE",
    "SHIFT",
    "STEPS",
    "SWINGS",
    "TURNS",
    "UPPER",
    "WIDTH",
    "pack",
    "turn_z_onto",
]

WIDTH = 16
# fmt: off
STEPS, DOF, SWINGS       = 0, 1, 2       # header: how many joint rows and limit rows; 1 where q of
                                         # the first joint turns it, and nothing else
ROTATION, POSITION       = 0, 9          # joint and tool: R row by row (9), then p (3)
TURNS, COLUMN            = 12, 13        # joint: 1 turns or 0 slides; which entry of q moves it
SCALE, SHIFT             = 14, 15        # joint: value = SCALE * q[COLUMN] + SHIFT
LOWER, UPPER, FULL_TURN  = 0, 1, 2       # limit: the range; 1 where every direction is inside it
# fmt: on

# Ranges from -3.14 to 3.14 in files are meant as full turns.
_FULL_TURN_RAD = 2.0 * math.pi - 1e-2


def pack(
    chain: Chain,
    frame: str | None = None,
    offset_m: Vector | None = None,
    tool_axis: Vector | None = None,
) -> Matrix:
    """Return the way to a point of a link as one array (2 + joints + dof, WIDTH).

    Args:
        chain: The arm.
        frame: Name of a link; the tip if None.
        offset_m: A point (3,) in that link's coordinates, metres; its origin if None.
        tool_axis: A unit vector (3,) in that link's coordinates; the packed tool's z points
            along it. The link's own z if None.

    Raises:
        UnknownNameError: No link is named ``frame``.
    """
    way = chain.way(frame)
    rows, rest = _joint_rows(way)
    if offset_m is not None:
        rest = rest @ pose(offset_m)
    if tool_axis is not None:
        rest = rest @ pose(np.zeros(3), turn_z_onto(tool_axis))
    header = np.zeros(WIDTH)
    header[STEPS], header[DOF] = len(rows), chain.dof
    header[SWINGS] = bool(rows) and _swings(chain, rows[0])
    return np.array([header, *rows, _placed(rest), *_limit_rows(chain)])


def turn_z_onto(axis: Vector) -> Matrix:
    """Return a rotation (3, 3) whose third column is the unit vector ``axis`` (3,)."""
    z = np.asarray(axis, dtype=np.float64)
    helper = np.eye(3)[0 if abs(z[0]) < 0.9 else 1]
    y = skew(z) @ helper
    y /= math.sqrt(float(y @ y))
    return np.array([skew(y) @ z, y, z]).T


def _joint_rows(way: tuple[Step, ...]) -> tuple[list[Vector], Matrix]:
    """Return a row for each joint that q moves, and what lies behind the last (4, 4)."""
    rows: list[Vector] = []
    rest = pose(np.zeros(3))
    for step in way:
        rest = rest @ step.joint.origin
        if not step.scale or step.joint.kind is JointKind.FIXED:
            rest = rest @ step.at(step.shift)
            continue
        turn = turn_z_onto(step.joint.axis)
        row = _placed(rest @ pose(np.zeros(3), turn))
        row[TURNS] = step.joint.kind is JointKind.REVOLUTE
        row[COLUMN], row[SCALE], row[SHIFT] = step.column, step.scale, step.shift
        rows.append(row)
        rest = pose(np.zeros(3), turn.T)
    return rows, rest


def _swings(chain: Chain, first: Vector) -> bool:
    plain = first[TURNS] == 1.0 and first[SCALE] == 1.0 and first[SHIFT] == 0.0
    return bool(plain) and not _is_followed(chain, int(first[COLUMN]))


def _placed(T: Matrix) -> Vector:
    row = np.zeros(WIDTH)
    row[ROTATION : ROTATION + 9] = T[:3, :3].ravel()
    row[POSITION : POSITION + 3] = T[:3, 3]
    return row


def _limit_rows(chain: Chain) -> list[Vector]:
    rows: list[Vector] = []
    for i, kind in enumerate(chain.kinds):
        row = np.zeros(WIDTH)
        row[LOWER], row[UPPER] = chain.lower_rad[i], chain.upper_rad[i]
        wide = chain.upper_rad[i] - chain.lower_rad[i] >= _FULL_TURN_RAD
        row[FULL_TURN] = wide and kind is JointKind.REVOLUTE and not _is_followed(chain, i)
        rows.append(row)
    return rows


def _is_followed(chain: Chain, column: int) -> bool:
    """Return whether other joints mimic this one: then a full turn of it is no identity."""
    followers = {
        step.joint.name
        for frame in chain.frames
        for step in chain.way(frame)
        if step.scale and step.column == column and step.joint.mimic is not None
    }
    return bool(followers)
