"""Inverse kinematics problems: arm, target, options, tolerance."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from ikservo.arguments import parse_number
from ikservo.errors import BadValueError, InputError, shown
from ikservo.kernels.layout import MAX_POSITION_M
from ikservo.kinematics import Chain, finite_array, finite_vector
from ikservo.kinematics.arrays import (
    Matrix,
    Vector,
    array_of_shape,
    bounded_vector,
    freeze_arrays,
    read_only,
)
from ikservo.kinematics.se3 import log_so3
from ikservo.model.arm_model import Model

ArmLike = Chain | Model | str | Path
"""An arm's chain or model, its name, or the path of its file."""

_TOOL_AXIS = (0.0, 0.0, 1.0)
_TOOL_AXIS_ARRAY = read_only(_TOOL_AXIS)


def chain_and_start(arm: ArmLike, q0: ArrayLike | None = None) -> tuple[Chain, ArrayLike | None]:
    """Return the chain of an arm, and the default start: a model's initial joints.

    Raises:
        BadValueError: The value is not an arm.
        UnknownNameError: No arm has that name.
    """
    if isinstance(arm, Chain):
        return arm, q0
    model: object = arm
    if isinstance(arm, str | Path):
        from ikservo.model import load_model  # noqa: PLC0415  # pydantic is slow to import

        model = load_model(arm)
    if not isinstance(model, Model):
        expected = 'a Chain, a Model, or the name or file of an arm, as in "so101"'
        raise BadValueError("The arm", shown(arm), expected)
    return model.chain, model.initial_joints() if q0 is None else q0


@dataclass(frozen=True, eq=False)
class Target:
    """A position for a point of the arm, with an optional direction or orientation.

    Attributes:
        position_m: Target position (3,) of the point, metres, in the arm's base frame.
        direction: Target direction (3,) of the tool axis, base frame; any length except zero.
        orientation: Target orientation R_world_tool (3, 3); not together with direction.
        frame: The link to which the point belongs; the tip if None.
        offset_m: The point in that link's coordinates (3,), metres; the link's origin if None.
        tool_axis: The axis (3,) in the link's coordinates for ``direction``.
        axis: The tool axis as a unit vector.
        packed: Position and rotation (4, 3) as the kernels read them; a direction is stored as the
            last column.

    Raises:
        InputError: A number is not finite, a shape is wrong, an axis has no length, the
            orientation is not a rotation, or both direction and orientation are given.
    """

    position_m: ArrayLike
    direction: ArrayLike | None = None
    orientation: ArrayLike | None = None
    frame: str | None = None
    offset_m: ArrayLike | None = None
    tool_axis: ArrayLike = _TOOL_AXIS
    axis: Vector = field(init=False, repr=False)
    packed: Matrix = field(init=False, repr=False)

    # Written out, because the method that dataclasses generate for a frozen class is three times
    # slower.
    def __init__(
        self,
        position_m: ArrayLike,
        direction: ArrayLike | None = None,
        orientation: ArrayLike | None = None,
        frame: str | None = None,
        offset_m: ArrayLike | None = None,
        tool_axis: ArrayLike = _TOOL_AXIS,
    ) -> None:
        if direction is not None and orientation is not None:
            raise InputError("The target has a direction and an orientation.", "Give one.")
        if frame is not None and not isinstance(cast("object", frame), str):
            expected = "the name of a link, or None for the tip"
            raise BadValueError("The frame", shown(frame), expected)
        if offset_m is not None:
            check_position(offset_m, "offset_m")
        fields = self.__dict__
        fields["position_m"] = position_m
        fields["direction"] = direction
        fields["orientation"] = orientation
        fields["frame"] = frame
        fields["offset_m"] = offset_m
        fields["tool_axis"] = tool_axis
        fields["axis"] = (
            _TOOL_AXIS_ARRAY if tool_axis is _TOOL_AXIS else normalise(tool_axis, "The tool axis")
        )
        fields["packed"] = _pack_target(position_m, direction, orientation)
        freeze_arrays(self)

    @property
    def position(self) -> Vector:
        """The target position (3,), metres, as a new array."""
        return self.packed[0]

    @property
    def target_axis(self) -> Vector | None:
        """The target direction (3,) as a unit vector, or None."""
        return None if self.direction is None else self.packed[1:, 2]

    @property
    def rotation(self) -> Matrix | None:
        """The target orientation (3, 3) as a new array, or None."""
        return None if self.orientation is None else self.packed[1:]

    @property
    def only_position(self) -> bool:
        """Whether the orientation of the tool is free."""
        return self.direction is None and self.orientation is None

    def orientation_error(self, R_world_tool: Matrix) -> Vector:
        """Compute the rotation vector (3,) [rad] from the tool's orientation to the target."""
        if self.rotation is not None:
            return log_so3(self.rotation @ R_world_tool.T)
        if self.target_axis is not None:
            return _rotation_between(R_world_tool @ self.axis, self.target_axis)
        return np.zeros(3)


def _rotation_between(a: Vector, b: Vector) -> Vector:
    """Compute the shortest rotation vector (3,) that rotates unit vector a to unit vector b."""
    normal = np.cross(a, b)
    sin, cos = math.sqrt(float(normal @ normal)), float(a @ b)
    if sin < 1e-12:
        if cos > 0:
            return np.zeros(3)
        # The vectors are opposite: half a turn about any axis perpendicular to ``a`` is equally
        # short.
        helper = np.zeros(3)
        helper[int(np.argmin(np.abs(a)))] = 1.0
        return math.pi * normalise(np.cross(a, helper), "axis")
    rotation: Vector = normal * (math.atan2(sin, cos) / sin)
    return rotation


def check_position(v: ArrayLike, what: str) -> Vector:
    """Check and copy a point (3,) [m]; raise BadValueError if it is not valid or beyond 1 km."""
    point = bounded_vector(v, 3, MAX_POSITION_M, what, "metres, within 1 km")
    return point.copy()  # changes to the caller's array must not change the target


def normalise(v: ArrayLike, what: str) -> Vector:
    """Scale a direction (3,) to length one; raise BadValueError if its length is zero."""
    vector = finite_vector(v, 3, what)
    length = math.hypot(*vector.tolist())
    if length < 1e-12:
        raise BadValueError(what, "zero", "a direction")
    if math.isinf(length):
        raise BadValueError(what, vector.tolist(), "a direction with a finite length")
    return vector / length


def _pack_target(
    position_m: ArrayLike, direction: ArrayLike | None, orientation: ArrayLike | None
) -> Matrix:
    """Pack position and rotation (4, 3); raise BadValueError if they are not valid."""
    packed = np.zeros((4, 3))
    packed[0] = array_of_shape(position_m, (3,), "The target position")
    if orientation is not None:
        packed[1:] = array_of_shape(orientation, (3, 3), "The orientation")
    elif direction is not None:
        packed[1:, 2] = normalise(direction, "The wanted direction")
    if _load_check()(packed, orientation is not None):
        return packed
    check_position(packed[0], "The target position")
    finite_array(packed[1:], (3, 3), "The orientation")
    raise BadValueError("The orientation", "not a rotation matrix", "R Rᵀ = 1 and det R = 1")


@cache
def _load_check() -> Callable[[Matrix, bool], bool]:
    """Load the check of a packed target, compiled if possible."""
    from ikservo.kernels.single import is_target  # noqa: PLC0415  # loads with the first target

    return is_target


DEFAULT_RESTARTS = 400
"""Default maximum number of starting points of a search."""

_FULL_POSE_DOF = 6
# A larger number of starting points is a mistake, because their table would fill the memory.
_MAX_COUNT = 1_000_000


@dataclass(frozen=True, slots=True)
class Tolerance:
    """The maximum errors with which a target counts as reached.

    Raises:
        BadValueError: A value is not a number above 0.
    """

    position_m: float = 1e-5
    orientation_rad: float = 1e-4

    def __post_init__(self) -> None:
        _check_above_0("A tolerance in metres", self.position_m)
        _check_above_0("A tolerance in radians", self.orientation_rad)


@dataclass(frozen=True, slots=True, eq=False)
class Posture:
    """A preferred configuration, used if the target leaves freedom.

    Attributes:
        q: The preferred joints (dof,), rad or m.
        weights: The weight of each joint (dof,); 0 leaves the joint free.
    """

    q: ArrayLike
    weights: ArrayLike


@dataclass(frozen=True, slots=True, eq=False)
class Options:
    """The options for all methods.

    Attributes:
        tolerance: The maximum errors with which a target counts as reached.
        restarts: Maximum number of starting points, the given start first; the Jacobian methods use
            only the given start.
        max_iterations: Maximum steps from one start; None uses the method's default.
        posture: Preferred configuration; methods without a null space ignore it.
        trace: Whether the result contains all iterates.
        position_first: Whether the position is met exactly and the orientation as well as possible
            after that, instead of weighing both; None: only if the arm has fewer than six joints.
        turn_weight_m_rad: Position error in metres that counts as much as one radian (``bounded``).
        track: Whether to use one start, and never to pass a limit or change branch (``bounded``).
        nearest: Whether to search for the solution nearest the start if there are several
            (``auto``); otherwise the first solution found is returned.
    """

    tolerance: Tolerance = field(default_factory=Tolerance)
    restarts: int = DEFAULT_RESTARTS
    max_iterations: int | None = None
    posture: Posture | None = None
    trace: bool = False
    position_first: bool | None = None
    turn_weight_m_rad: float = 0.2
    track: bool = False
    nearest: bool = True

    def __post_init__(self) -> None:
        check_count("restarts", self.restarts)
        if self.max_iterations is not None:
            check_count("max_iterations", self.max_iterations)
        _check_above_0("turn_weight_m_rad", self.turn_weight_m_rad)
        if math.isinf(self.turn_weight_m_rad):
            raise BadValueError("turn_weight_m_rad", self.turn_weight_m_rad, "a finite number")
        for what in ("track", "trace", "nearest"):
            _check_kind(what, getattr(self, what), bool)
        if self.position_first is not None:
            _check_kind("position_first", self.position_first, bool)
        _check_kind("The tolerance", self.tolerance, Tolerance)
        if self.posture is not None:
            _check_kind("The posture", self.posture, Posture)

    def puts_position_first(self, dof: int) -> bool:
        """Check whether the position has priority for an arm with this number of joints."""
        return dof < _FULL_POSE_DOF if self.position_first is None else self.position_first


def _check_above_0(what: str, value: float) -> None:
    if not parse_number(what, value) > 0.0:
        raise BadValueError(what, shown(value), "a number above 0")


def check_count(what: str, value: int) -> None:
    """Raise BadValueError if a value is not a whole number from 1 to ``_MAX_COUNT``."""
    is_whole = isinstance(cast("object", value), int | np.integer) and value is not True
    if not is_whole or not 1 <= value <= _MAX_COUNT:
        raise BadValueError(what, shown(value), f"a whole number from 1 to {_MAX_COUNT}")


def _check_kind(what: str, value: object, kind: type) -> None:
    if not isinstance(value, kind):
        raise BadValueError(what, shown(value), f"a {kind.__name__}")
