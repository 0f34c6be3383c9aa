"""The joints' curve for a path of the tool, held as well as the arm can hold it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ikservo.errors import LineError
from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Vector, log_so3
from ikservo.motion.plane import ArmPlane
from ikservo.motion.rounded import Rounded
from ikservo.motion.spline import Spline
from ikservo.motion.turning import Turning
from ikservo.motion.walk import walk

__all__ = ["KEPT_RAD", "ToolCurve", "tool_curve"]

KEPT_RAD = math.radians(0.5)
"""How far the tool may be from how it should stand and still stand so."""

_STEPS_M = (0.002, 0.001, 0.0005)
_STEP_RAD = 0.02
_LEAST_POINTS = 5
# A turn in place has no length of its own; this is what a radian counts for, metres.
_LEVER_M = 0.1
# Half of what a line may stray, for the servos' ticks have their share.
_STRAY_M = 0.25e-3
_ROUNDING = 1e-9
_BETWEEN = 4


@dataclass(frozen=True, slots=True, eq=False)
class ToolCurve:
    """The way of the joints along a path of the tool.

    Attributes:
        spline: The joints (dof,) over a distance that is at least the path's.
        left_rad: How far the tool is from how it should stand, along the way (k,).
    """

    spline: Spline
    left_rad: Vector


def tool_curve(
    chain: Chain, start: Vector, path: Rounded, end: Vector | None = None, *, strict: bool = False
) -> ToolCurve:
    """Find the joints along a path of the tool.

    The tool goes on to stand as it stands, against the plane of arms that have one, or is turned
    evenly to how it stands at ``end``. Where the arm cannot have that all along, it is turned
    evenly to what the arm has at the path's end; else as it comes.

    Args:
        chain: The arm.
        start: The joints where it begins (dof,).
        path: Where the tip goes, metres, base frame.
        end: Joints (dof,) with the orientation to turn to; None to keep the one at the start.
        strict: Whether the orientation shall be kept in the world, and nothing else will do.

    Raises:
        LineError: The path cannot be followed; says where, of the way that led furthest.
    """
    wish = _wish(chain, start, end, strict=strict)
    if strict:
        return _kept(chain, wish, path, _smooth(chain, start, path, wish))
    failed: list[LineError] = []
    found: list[ToolCurve] = []
    for turned in (_as_wished, _evenly, _as_it_comes):
        try:
            spline = _smooth(chain, start, path, turned(chain, start, path, wish))
        except LineError as error:
            failed.append(error)
            continue
        found.append(_measured(chain, wish, spline))
        # What goes as wished, though not quite, may do so with corners; an even turn has none.
        if turned is not _as_wished or found[0].left_rad.max() <= KEPT_RAD:
            break
    if not found:
        raise max(failed, key=lambda error: error.along_m)
    return found[-1]


def _wish(chain: Chain, start: Vector, end: Vector | None, *, strict: bool) -> Turning:
    last = start if end is None else end
    here, there = (chain.forward(q)[:3, :3] for q in (start, last))
    return Turning.between(ArmPlane(chain, in_world=strict), (here, start), (there, last))


def _as_wished(chain: Chain, start: Vector, path: Rounded, wish: Turning) -> Turning:
    _ = chain, start, path
    return wish


def _evenly(chain: Chain, start: Vector, path: Rounded, wish: Turning) -> Turning:
    """Return the even turn to what the arm has at the path's end, when it tries its best."""
    joints = walk(chain, start, path, wish, _counts(path, wish)[0])
    here, there = (chain.forward(q)[:3, :3] for q in (start, joints[-1]))
    return Turning.between(wish.plane, (here, start), (there, joints[-1]))


def _as_it_comes(chain: Chain, start: Vector, path: Rounded, wish: Turning) -> None:
    _ = chain, start, path, wish


def _smooth(chain: Chain, start: Vector, path: Rounded, turning: Turning | None) -> Spline:
    """Return the spline through so many points that it stays on the path between them."""
    astray_m = 0.0
    turn_rad = 0.0 if turning is None else float(np.linalg.norm(turning.turn_rad))
    length = max(path.length, _LEVER_M * turn_rad, 1e-9)
    for count in _counts(path, turning):
        joints = walk(chain, start, path, turning, count)
        spline = Spline(np.linspace(0.0, length, count), joints)
        strays_m = _strays(chain, path, spline, _BETWEEN * (count - 1) + 1)
        if strays_m.max() <= _STRAY_M:
            return spline
        astray_m = float(strays_m.argmax()) / (len(strays_m) - 1) * path.length
    at_m = path.at(astray_m)[0].tolist()
    raise LineError(
        astray_m, at_m, at_m, ["the joints would have to turn too sharply (singularity)"]
    )


def _counts(path: Rounded, turning: Turning | None) -> list[int]:
    turn_rad = 0.0 if turning is None else float(np.linalg.norm(turning.turn_rad))
    return [
        max(_LEAST_POINTS, 1 + math.ceil(max(path.length / step_m, turn_rad / _STEP_RAD)))
        for step_m in _STEPS_M
    ]


def _strays(chain: Chain, path: Rounded, spline: Spline, looks: int) -> Vector:
    """Return how far the tip is from the path (looks,); infinite where a limit is left."""
    shares = np.linspace(0.0, 1.0, looks)
    q = spline.points(shares * spline.length)
    wanted = np.array([path.at(share * path.length)[0] for share in shares])
    strays: Vector = np.linalg.norm(chain.forward(q)[:, :3, 3] - wanted, axis=1)
    lower, upper = np.minimum(chain.lower_rad, q[0]), np.maximum(chain.upper_rad, q[0])
    outside = ((q < lower - _ROUNDING) | (q > upper + _ROUNDING)).any(axis=1)
    return np.where(outside, np.inf, strays)


def _measured(chain: Chain, wish: Turning, spline: Spline) -> ToolCurve:
    shares = np.linspace(0.0, 1.0, max(_LEAST_POINTS, len(spline.distances)))
    joints = spline.points(shares * spline.length)
    rotations = chain.forward(joints)[:, :3, :3]
    return ToolCurve(spline, _left(wish, shares.tolist(), joints, rotations))


def _left(wish: Turning, shares: Sequence[float], joints: Vector, rotations: Vector) -> Vector:
    turns = [
        log_so3(wish.at(share, q) @ R.T)
        for share, q, R in zip(shares, joints, rotations, strict=True)
    ]
    return np.linalg.norm(turns, axis=1)


def _kept(chain: Chain, wish: Turning, path: Rounded, spline: Spline) -> ToolCurve:
    """Return the curve, if the tool stands as it should all along."""
    curve = _measured(chain, wish, spline)
    wrong = np.flatnonzero(curve.left_rad > KEPT_RAD)
    if not len(wrong):
        return curve
    along_m = float(wrong[0]) / (len(curve.left_rad) - 1) * path.length
    at_m = path.at(along_m)[0].tolist()
    turned = math.degrees(curve.left_rad.max())
    raise LineError(along_m, at_m, at_m, [f"the tool would turn by up to {turned:.1f}°"])
