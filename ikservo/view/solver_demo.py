"""The planar demonstration of solver methods, iteration by iteration.

::

    model = planar_model([0.12, 0.10, 0.08])          # or any flat arm of the catalogue
    lesson = teach(model.chain, target_m, q0, "ccd")
    for k in range(lesson.count):
        items = lesson.items(k, camera)               # painted over Theatre(model).items(…)
        words = lesson.words(k)                       # "ccd, iteration 12 of 40: 3.2 mm left"

Every method starts at the same joints, inside the same limits, and stops by the same rule, so
that a person can compare them on one target.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from ikservo.errors import BadValueError
from ikservo.ik import METHODS, Posture, Result, Target, solve
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.model import Model
from ikservo.model.loading import build_chain
from ikservo.model.urdf_types import Cylinder, Urdf, UrdfJoint, UrdfJointType, UrdfLink
from ikservo.view.camera import Camera
from ikservo.view.draw_items import DrawItem, circle, cross, polyline

__all__ = ["ITERATIVE", "SOLVERS", "SolverTrace", "planar_model", "trace_method"]

SOLVERS: tuple[str, ...] = tuple(METHODS)
"""The methods to choose from."""

ITERATIVE = ("pseudo_inverse", "transpose", "ccd")
"""Those that go on from where the arm is: where they end is not always the nearest point."""

_MAX_SHOWN = 200
_TRAIL = 10
_MAX_LINKS = 12
_JOINT_PX, _CROSS_PX = 4.0, 9.0


@dataclass(frozen=True, slots=True, eq=False)
class SolverTrace:
    """What a method did on its way to a target.

    Attributes:
        result: How it ended.
        target_m: What was wanted (3,), metres.
        numbers: Which iteration each shown step is (count,); long ways are thinned evenly.
        lines_m: The arm at each shown step (count, points, 3), base to tip, metres.
    """

    result: Result
    target_m: Vector
    numbers: tuple[int, ...]
    lines_m: Matrix

    @property
    def count(self) -> int:
        """Return how many steps there are to show, the start included."""
        return len(self.numbers)

    def distance_left_m(self, step: int) -> float:
        """Return how far the tip is from the target at a step."""
        return math.dist(self.lines_m[step, -1], self.target_m)

    def items(self, step: int, camera: Camera) -> list[DrawItem]:
        """Return the arm at a step in front of those before it, the tip's way, and the target."""
        px, _ = camera.project(self.lines_m[: step + 1])
        at, _ = camera.project(self.target_m)
        last = step == self.count - 1
        style = "target" if not last or self.result.reached else "target_far"
        return [
            *(polyline("iteration", line) for line in px[:: max(1, len(px) // _TRAIL)]),
            polyline("trace", px[:, -1]),
            polyline("gap", [px[-1, -1], at]),
            polyline("iterate", px[-1]),
            *(circle("joint", joint, _JOINT_PX) for joint in px[-1, :-1]),
            circle("tip", px[-1, -1], _JOINT_PX),
            cross(style, at, _CROSS_PX),
        ]

    def format_step(self, step: int) -> str:
        """Return which iteration a step is, and what is left of the way."""
        left = f"{self.distance_left_m(step) * 1000:.1f} mm left"
        return f"{self.result.method}, iteration {self.numbers[step]} of {self.numbers[-1]}: {left}"


def trace_method(
    chain: Chain,
    target_m: ArrayLike,
    q0: ArrayLike,
    method: str,
    posture: Posture | None = None,
) -> SolverTrace:
    """Let a method solve for a target from ``q0`` (dof,) and keep what it does.

    Args:
        chain: The arm.
        target_m: Where the tip shall be (3,), metres.
        q0: Where it starts (dof,).
        method: One of ``SOLVERS``.
        posture: What to lean towards (lecture L10), where the method has a null space.

    Raises:
        UnknownNameError: There is no such method.
        BadValueError: The target or q0 makes no sense.
    """
    target = Target(target_m)
    result = solve(chain, target, q0, method, trace=True, restarts=1, posture=posture)
    steps = np.array(result.trace or (chain.clip(q0), result.q))
    shown = np.unique(np.linspace(0, len(steps) - 1, min(len(steps), _MAX_SHOWN)).round())
    numbers = shown.astype(int)
    return SolverTrace(
        result=result,
        target_m=target.position,
        numbers=tuple(numbers.tolist()),
        lines_m=_arm_points(chain, steps[numbers]),
    )


def planar_model(lengths_m: Sequence[float], limit_rad: float = math.pi) -> Model:
    """Return an arm in the plane z = 0 with a turning joint before each link.

    Args:
        lengths_m: The links, base to tip, metres.
        limit_rad: How far each joint turns to either side.

    Raises:
        BadValueError: No links, too many, or a length or limit that is none.
    """
    _check_lengths(lengths_m, limit_rad)
    names = ["base", *(f"link{i + 1}" for i in range(len(lengths_m))), "tool"]
    before = [0.0, *lengths_m]
    joints = [
        _make_planar_joint(f"joint{i + 1}", names[i], names[i + 1], before[i], limit_rad)
        for i in range(len(lengths_m))
    ]
    joints.append(_make_planar_joint("tip", names[-2], names[-1], before[-1], None))
    radius_m = 0.06 * max(lengths_m)
    links = [
        _make_bar_link(name, length, radius_m)
        for name, length in zip(names[1:], lengths_m, strict=False)
    ]
    ends = [
        _make_bar_link("base", 0.0, 1.6 * radius_m),
        *links,
        _make_bar_link("tool", None, radius_m),
    ]
    urdf = Urdf("planar", tuple(ends), tuple(joints), "base")
    title = f"{len(lengths_m)} links in a plane"
    return Model.from_geometry(
        "planar", title, build_chain(urdf, "tool"), urdf, Path("planar.urdf")
    )


def _check_lengths(lengths_m: Sequence[float], limit_rad: float) -> None:
    if not 1 <= len(lengths_m) <= _MAX_LINKS:
        raise BadValueError("The number of links", len(lengths_m), f"1 to {_MAX_LINKS}")
    for length_m in lengths_m:
        if not 0.0 < length_m < 100.0:
            raise BadValueError("A link's length", length_m, "metres, above 0")
    if not 0.0 < limit_rad <= math.tau:
        raise BadValueError("The limit of the joints", limit_rad, "radians, above 0")


def _arm_points(chain: Chain, q: Matrix) -> Matrix:
    """Return the pivots and the tip (n, points, 3) at joints (n, dof)."""
    links = [step.joint.child for step in chain.joints_to() if step.scale]
    points = [chain.forward(q, link)[:, :3, 3] for link in (*links, chain.tip)]
    return np.stack(points, axis=1)


def _make_planar_joint(
    name: str, parent: str, child: str, x_m: float, limit_rad: float | None
) -> UrdfJoint:
    kind = UrdfJointType.FIXED if limit_rad is None else UrdfJointType.REVOLUTE
    limit = limit_rad or 0.0
    return UrdfJoint(
        name, kind, parent, child, (x_m, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0),
        -limit, limit, math.inf, math.inf, None, 1,
    )  # fmt: skip


def _make_bar_link(name: str, length_m: float | None, radius_m: float) -> UrdfLink:
    """Return a link that is a bar along x; one without a length has no body."""
    body = () if length_m is None else (
        Cylinder(radius_m, length_m, (0.5 * length_m, 0.0, 0.0), (0.0, math.pi / 2, 0.0)),
    )  # fmt: skip
    none = (0.0, 0.0, 0.0)
    return UrdfLink(name, 0.0, none, none, (*none, *none), body, body, 1)
