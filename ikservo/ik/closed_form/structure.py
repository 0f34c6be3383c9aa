"""What kind of arm a chain is: recognised from its joint axes, not from its name.

While all joints are zero, every joint is a line in space. Parallel lines make the plane of the
arm; a first line across them is the base yaw, the lines behind them are the wrist. Offsets of any
kind are allowed, for turning parallel joints never changes what is across their plane.
"""

from __future__ import annotations

from dataclasses import replace
from weakref import WeakKeyDictionary

import numpy as np

from ikservo.ik.closed_form.anatomy import Plane, Structure, Turn
from ikservo.ik.closed_form.orbits import Spin, frame_across
from ikservo.ik.closed_form.three_turns import ThreeTurns
from ikservo.kinematics import Chain, JointKind
from ikservo.kinematics.se3 import Matrix, Vector

__all__ = ["structure"]

# Axes closer to parallel than this count as parallel, and lines that pass as close as this as
# meeting: wide enough for the rounded angles of published URDFs and for calibrated arms.
_NEARLY_PARALLEL_RAD = 1e-3
_NEARLY_MEETING_M = 1e-4
_SAME_POSE = 1e-9


def structure(chain: Chain, frame: str | None = None) -> Structure | None:
    """Return what kind of arm moves a frame (the tip if None), or None if it is none of ours."""
    known = _known.setdefault(chain, {})
    if frame not in known:
        known[frame] = _recognised(chain, frame)
    return known[frame]


_known: WeakKeyDictionary[Chain, dict[str | None, Structure | None]] = WeakKeyDictionary()


def _recognised(chain: Chain, frame: str | None) -> Structure | None:
    turns = _turns(chain, frame)
    tool = chain.forward(np.zeros(chain.dof), frame)
    if turns is None or not _describes(turns, tool, chain, frame):
        return None
    found = _assembled(turns, tool)
    return None if found is None else replace(found, straight=_straight(found, turns))


def _assembled(turns: tuple[Turn, ...], tool: Matrix) -> Structure | None:
    """Return yaw, parallel links and wrist of the turns, or None if they are not in that order."""
    if len(turns) < 2:
        return None
    first = 0 if _parallel(turns[0], turns[1]) else 1
    count = _parallel_run(turns[first:])
    yaw, parallel, wrist = turns[:first], turns[first : first + count], turns[first + count :]
    if count not in (2, 3) or (wrist and not yaw):
        return None
    plane, tilt = _plane(parallel)
    centre, gap_m = _meeting_point(wrist)
    return Structure(
        yaw=yaw[0] if yaw else None,
        plane=plane,
        wrist=wrist,
        centre=centre,
        tool=tool,
        deviation=max(tilt, gap_m),
        yaw_back=Spin(plane.frame, -yaw[0].axis, yaw[0].point) if yaw else Spin(plane.frame),
        roll=Spin(plane.frame, wrist[0].axis, wrist[0].point) if wrist else Spin(plane.frame),
        orient=_orienting(plane, wrist) if centre is not None else None,
    )


def _straight(arm: Structure, turns: tuple[Turn, ...]) -> Structure | None:
    """Return two links and a wrist as three links, where the wrist's first joint can be zero."""
    if len(arm.plane.pivots) != 2 or len(arm.wrist) < 2:
        return None
    roll = arm.wrist[0]
    straight = _assembled(tuple(turn for turn in turns if turn is not roll), arm.tool)
    if straight is None or not straight.exact or len(straight.plane.pivots) != 3:
        return None
    return replace(straight, zeroed=roll.column) if roll.lower <= 0.0 <= roll.upper else None


def _orienting(plane: Plane, wrist: tuple[Turn, ...]) -> ThreeTurns | None:
    """Return the three last turns that orient the tool without moving the wrist's centre.

    Two links leave them to a wrist of three joints; three links give the first of them.
    """
    axes = [turn.axis for turn in wrist]
    if len(plane.pivots) == 3:
        axes.insert(0, plane.frame[2])
    return ThreeTurns(*axes) if len(axes) == 3 else None


def _turns(chain: Chain, frame: str | None) -> tuple[Turn, ...] | None:
    """Read every joint that moves the frame from the Jacobian; None if one does not turn.

    A column is (axis × r, axis) with r from the axis to the frame, so r = (axis × r) × axis.
    """
    T, J = chain.linearise(np.zeros(chain.dof), frame)
    turns: list[Turn] = []
    for i in np.flatnonzero(np.abs(J).sum(axis=0)):
        if chain.kinds[i] is not JointKind.REVOLUTE:
            return None
        lower, upper = float(chain.lower_rad[i]), float(chain.upper_rad[i])
        axis, r = J[3:, i], np.cross(J[:3, i], J[3:, i])
        turns.append(Turn(int(i), axis, T[:3, 3] - r, lower, upper))
    return tuple(turns)


def _describes(turns: tuple[Turn, ...], tool: Matrix, chain: Chain, frame: str | None) -> bool:
    """Return whether the turns move the frame as the chain does; a mimicking joint would not."""
    for seed in (0.3, -1.1):
        q = seed + 0.7 * np.arange(chain.dof)
        T = tool
        for turn in reversed(turns):
            T = turn.applied(float(q[turn.column]), T)
        if float(np.abs(T - chain.forward(q, frame)).max()) > _SAME_POSE:
            return False
    return True


def _parallel(a: Turn, b: Turn) -> bool:
    sine = np.cross(a.axis, b.axis)
    return float(np.sqrt(sine @ sine)) < _NEARLY_PARALLEL_RAD


def _parallel_run(turns: tuple[Turn, ...]) -> int:
    """Return how many joints from the first on are parallel to it."""
    different = (i for i, turn in enumerate(turns) if not _parallel(turns[0], turn))
    return next(different, len(turns))


def _plane(turns: tuple[Turn, ...]) -> tuple[Plane, float]:
    """Return the plane across parallel joints, and how far the worst is from parallel [rad]."""
    n = turns[0].axis
    frame = frame_across(n)
    signs = tuple(1 if float(turn.axis @ n) > 0 else -1 for turn in turns)
    return Plane(
        frame=frame,
        pivots=tuple(complex(*(frame[:2] @ turn.point)) for turn in turns),
        columns=tuple(turn.column for turn in turns),
        signs=signs,
        limits=tuple(_about_n(turn, sign) for turn, sign in zip(turns, signs, strict=True)),
    ), max(float(np.abs(s * t.axis - n).max()) for s, t in zip(signs, turns, strict=True))


def _about_n(turn: Turn, sign: int) -> tuple[float, float]:
    return (turn.lower, turn.upper) if sign > 0 else (-turn.upper, -turn.lower)


def _meeting_point(turns: tuple[Turn, ...]) -> tuple[Vector | None, float]:
    """Return where the axes of two or three joints meet (3,), and how far they pass by it [m]."""
    if len(turns) not in (2, 3) or _parallel(turns[0], turns[1]):
        return None, 0.0
    beside = [np.eye(3) - np.outer(turn.axis, turn.axis) for turn in turns]
    offsets = [B @ turn.point for B, turn in zip(beside, turns, strict=True)]
    centre = np.asarray(np.linalg.solve(sum(beside), sum(offsets)), dtype=np.float64)
    gaps = [np.linalg.norm(B @ centre - o) for B, o in zip(beside, offsets, strict=True)]
    gap_m = float(max(gaps))
    return (centre, gap_m) if gap_m < _NEARLY_MEETING_M else (None, 0.0)
