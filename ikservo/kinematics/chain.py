"""A kinematic chain: forward kinematics, Jacobians, joint limits."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from ikservo.errors import BadValueError, InputError, UnknownNameError, shown
from ikservo.kinematics.arrays import (
    Matrix,
    Vector,
    as_floats,
    finite_array,
    finite_vector,
    finite_vectors,
    read_only,
)
from ikservo.kinematics.joints import (
    ChainJoint,
    Joint,
    JointType,
    effective_limits,
    joints_to_each_link,
    make_chain_joint,
)
from ikservo.kinematics.se3 import make_pose


@dataclass(frozen=True, eq=False)
class Chain:
    """The joints that move the tip, and every link connected to them.

    ``q`` is (dof,): rad for revolute joints, m for prismatic joints, ordered from base to tip.
    Joints that are not on the path to the tip (a gripper's jaw) are at the value nearest zero
    inside their limits, so that every link of the arm can be used as a frame. A joint that other
    joints follow (mimic) has limits that also keep its followers inside their own.

    An arm that bends between its joints' sensors and its links has ``link_joints``: poses are then
    those of the links for joint vectors that the sensors measure; ``jacobian`` refers to the link
    joints.

    Attributes:
        base: The root link; its coordinates are world coordinates.
        tip: The default frame of ``forward`` and ``jacobian``.
        names: Names of the moving joints, base to tip.
        lower_rad: Lower limits (dof,), rad (m for a prismatic joint); -inf for a continuous joint.
        upper_rad: Upper limits (dof,).
        kinds: The type of each joint.
        link_joints: Computes the link joints (dof,) or (n, dof) from the sensor joints (see
            ``Bending``); None if the arm does not bend between sensors and links.
    """

    base: str
    tip: str
    names: tuple[str, ...]
    lower_rad: Vector
    upper_rad: Vector
    kinds: tuple[JointType, ...]
    _paths: Mapping[str, tuple[ChainJoint, ...]] = field(repr=False)
    link_joints: Callable[[Vector], Vector] | None = field(default=None, repr=False)

    @classmethod
    def from_joints(cls, joints: Sequence[Joint], base: str, tip: str) -> Chain:
        """Build the chain from ``base`` to ``tip`` from a tree of joints, given in any order.

        Raises:
            InputError: No joint on the path to the tip moves, or followers leave a joint no range.
            UnknownNameError: ``tip`` is not connected to ``base``, or a mimic's leader is missing.
        """
        paths = joints_to_each_link(joints, base)
        if tip not in paths:
            raise UnknownNameError("link", tip, paths)
        moving = [j for j in paths[tip] if j.kind is not JointType.FIXED and j.mimic is None]
        if not moving:
            raise InputError(f"No joint moves {tip!r} relative to {base!r}.", "Choose another tip.")
        columns = {joint.name: i for i, joint in enumerate(moving)}
        by_name = {joint.name: joint for joint in joints}
        steps = {joint.name: make_chain_joint(joint, columns, by_name) for joint in joints}
        limits = np.array(effective_limits(moving, joints))
        return cls(
            base=base,
            tip=tip,
            names=tuple(columns),
            lower_rad=read_only(limits[:, 0]),
            upper_rad=read_only(limits[:, 1]),
            kinds=tuple(j.kind for j in moving),
            _paths={
                link: tuple(steps[joint.name] for joint in path) for link, path in paths.items()
            },
        )

    @property
    def dof(self) -> int:
        """The number of joints that move the tip."""
        return len(self.names)

    @property
    def frames(self) -> tuple[str, ...]:
        """The names of all links; each can be a ``frame``."""
        return tuple(self._paths)

    @cached_property
    def rigid(self) -> Chain:
        """The same chain without ``link_joints``."""
        return self if self.link_joints is None else replace(self, link_joints=None)

    def joints_to(self, frame: str | None = None) -> tuple[ChainJoint, ...]:
        """Return the joints from the base to a link (the tip if None), including fixed joints.

        Raises:
            UnknownNameError: There is no link named ``frame``.
        """
        try:
            return self._paths[self.tip if frame is None else frame]
        except (KeyError, TypeError):  # unknown, or not a name
            raise UnknownNameError("link", str(frame), self._paths) from None

    def with_limits(self, lower: ArrayLike, upper: ArrayLike) -> Chain:
        """Return the same chain with different limits, (dof,) each, rad or m.

        Raises:
            BadValueError: A limit is not a number, a lower limit is above the upper one, a shape is
                wrong, or a joint that was limited would have no limit.
        """
        low = self._check_limits(lower, self.lower_rad, "lower limits")
        high = self._check_limits(upper, self.upper_rad, "upper limits")
        for name, a, b in zip(self.names, low, high, strict=True):
            if a > b:
                raise BadValueError(f"The range of {name}", f"[{a:g}, {b:g}]", "lower <= upper")
        return replace(self, lower_rad=read_only(low), upper_rad=read_only(high))

    def with_slide(self, axis: ArrayLike, lower_m: float, upper_m: float) -> Chain:
        """Return a copy with an added prismatic joint, which moves the tip along ``axis`` (3,).

        Raises:
            BadValueError: ``axis`` has a wrong shape or is not finite.
        """
        along = read_only(finite_vector(axis, 3, "The axis"))
        name, column = f"{self.tip} sight", self.dof
        joint = Joint(
            name, JointType.PRISMATIC, self.tip, name, read_only(np.eye(4)), along, lower_m, upper_m
        )
        path = (*self.joints_to(), ChainJoint(joint, column, 1.0, 0.0))
        return replace(
            self,
            tip=name,
            names=(*self.names, name),
            lower_rad=read_only(np.append(self.lower_rad, lower_m)),
            upper_rad=read_only(np.append(self.upper_rad, upper_m)),
            kinds=(*self.kinds, JointType.PRISMATIC),
            link_joints=self.link_joints and _before_slide(self.link_joints),
            _paths={**self._paths, name: path},
        )

    def with_frame(self, name: str, link: str) -> Chain:
        """Return a copy with a new frame, which is fixed to a link, in the link's coordinates.

        Raises:
            UnknownNameError: There is no link named ``link``.
        """
        joint = Joint(
            name, JointType.FIXED, link, name, read_only(np.eye(4)), read_only(np.zeros(3))
        )
        path = (*self.joints_to(link), ChainJoint(joint, 0, 0.0, 0.0))
        return replace(self, _paths={**self._paths, name: path})

    def with_origins(self, origins: Mapping[str, Matrix]) -> Chain:
        """Return the same chain with different origins ``T_parent_joint`` (4, 4) of some joints.

        Raises:
            UnknownNameError: The arm has no joint with that name.
            BadValueError: An origin is not an array (4, 4) of finite numbers.
        """
        if not isinstance(cast("object", origins), Mapping):
            raise BadValueError("The mapping of origins", shown(origins), "poses (4, 4) by joint")
        known = {step.joint.name for path in self._paths.values() for step in path}
        for name, T in origins.items():
            if name not in known:
                raise UnknownNameError("joint", name, known)
            finite_array(T, (4, 4), f"The origin of {name}")
        paths = {
            link: tuple(_with_origin(step, origins) for step in path)
            for link, path in self._paths.items()
        }
        return replace(self, _paths=paths)

    def clip(self, q: ArrayLike) -> Vector:
        """Return ``q`` (dof,) or (n, dof) with every joint at its nearest value inside limits.

        Raises:
            BadValueError: ``q`` has a wrong shape or is not finite.
        """
        clipped: Vector = np.clip(finite_vectors(q, self.dof, "q"), self.lower_rad, self.upper_rad)
        return clipped

    def mid_range(self) -> Vector:
        """Return the middle of every range (dof,); zero for continuous joints."""
        bounded = np.isfinite(self.lower_rad) & np.isfinite(self.upper_rad)
        middle = np.zeros(self.dof)
        middle[bounded] = 0.5 * (self.lower_rad[bounded] + self.upper_rad[bounded])
        return self.clip(middle)

    def forward(
        self, q: ArrayLike, frame: str | None = None, offset_m: ArrayLike | None = None
    ) -> Matrix:
        """Compute the pose of a link, or of a point fixed to it.

        ``f(q) = O1 M1(q1) O2 M2(q2) … offset`` with the fixed origins O and joint motions M.

        Args:
            q: Joint vector (dof,), rad or m; or many of them, (n, dof).
            frame: Name of a link; the tip if None.
            offset_m: A point (3,) in that link's coordinates, metres; the link's origin if None.

        Returns:
            T_world_frame (4, 4), or (n, 4, 4); the offset moves its origin without rotating it.

        Raises:
            BadValueError: ``q`` or ``offset_m`` has a wrong shape or is not finite.
            UnknownNameError: There is no link named ``frame``.
        """
        q = self._links(q)
        T = _identity_poses(q)
        for step in self.joints_to(frame):
            T = T @ step.joint.origin @ step.motion(q)
        return _offset_pose(T, offset_m)

    def jacobian(
        self, q: ArrayLike, frame: str | None = None, offset_m: ArrayLike | None = None
    ) -> Matrix:
        """Return the Jacobian of the point, in world coordinates.

        Column i of a revolute joint is ``(axis x (f(q) - pivot), axis)``, of a prismatic joint
        ``(axis, 0)``.

        Args:
            q: Joint vector (dof,), rad or m; or many of them, (n, dof).
            frame: Name of a link; the tip if None.
            offset_m: A point (3,) in that link's coordinates, metres; the link's origin if None.

        Returns:
            J (6, dof), or (n, 6, dof): linear rows [m/rad or m/m] first, angular rows [rad/rad]
            second.

        Raises:
            BadValueError: ``q`` or ``offset_m`` has a wrong shape or is not finite.
            UnknownNameError: There is no link named ``frame``.
        """
        return self.forward_and_jacobian(q, frame, offset_m)[1]

    def forward_and_jacobian(
        self, q: ArrayLike, frame: str | None = None, offset_m: ArrayLike | None = None
    ) -> tuple[Matrix, Matrix]:
        """Return ``forward`` and ``jacobian`` of one point in one pass."""
        q = self._links(q)
        T = _identity_poses(q)
        passed: list[tuple[ChainJoint, Matrix]] = []
        for step in self.joints_to(frame):
            T_world_joint = T @ step.joint.origin
            passed.append((step, T_world_joint))
            T = T_world_joint @ step.motion(q)
        T = _offset_pose(T, offset_m)
        J = np.zeros((*q.shape[:-1], 6, self.dof))
        for step, T_world_joint in passed:
            if step.scale:
                column = step.jacobian_column(T_world_joint, T[..., :3, 3])
                J[..., step.column] += step.scale * column
        return T, J

    def link_poses(self, q: ArrayLike) -> dict[str, Matrix]:
        """Compute T_world_link (4, 4) or (n, 4, 4) of every link at ``q`` (dof,) or (n, dof)."""
        q = self._links(q)
        poses = {self.base: _identity_poses(q)}
        for link, path in self._paths.items():
            if path:  # the parents come first, the base itself has no joints
                step = path[-1]
                poses[link] = poses[step.joint.parent] @ step.joint.origin @ step.motion(q)
        return poses

    def _links(self, q: ArrayLike) -> Vector:
        """Compute the link joints' positions (dof,) or (n, dof) from the measured positions."""
        joints = finite_vectors(q, self.dof, "q")
        return joints if self.link_joints is None else self.link_joints(joints)

    def _check_limits(self, limits: ArrayLike, present: Vector, what: str) -> Vector:
        """Check limits (dof,); the limits of a continuous joint may stay infinite."""
        array = as_floats(limits, what, f"numbers of shape ({self.dof},)")
        if array.shape == present.shape:
            open_ended = np.isinf(present) & (array == present)
            finite_vector(np.where(open_ended, 0.0, array), self.dof, what)
            return array
        return finite_vector(array, self.dof, what)


def _before_slide(link_joints: Callable[[Vector], Vector]) -> Callable[[Vector], Vector]:
    """Extend ``link_joints`` to joint vectors that end with a rigid slide."""
    return lambda q: np.concatenate([link_joints(q[..., :-1]), q[..., -1:]], axis=-1)


def _with_origin(step: ChainJoint, origins: Mapping[str, Matrix]) -> ChainJoint:
    """Return the step with its joint's new origin (4, 4), if there is one."""
    if step.joint.name not in origins:
        return step
    joint = replace(step.joint, origin=read_only(origins[step.joint.name]))
    return ChainJoint(joint, step.column, step.scale, step.shift)


def _identity_poses(q: Vector) -> Matrix:
    return np.broadcast_to(np.eye(4), (*q.shape[:-1], 4, 4))


def _offset_pose(T: Matrix, offset_m: ArrayLike | None) -> Matrix:
    return T if offset_m is None else T @ make_pose(finite_vector(offset_m, 3, "offset_m"))


def joint_torques(
    chain: Chain,
    q: ArrayLike,
    force_n: ArrayLike,
    *,
    moment_nm: ArrayLike = (0.0, 0.0, 0.0),
    frame: str | None = None,
    offset_m: ArrayLike | None = None,
) -> Vector:
    """Compute the joint torques that a force at a point of the arm causes: ``tau = Jᵀ F``.

    A small motion dq of the joints moves the point by ``J dq``, and the force does the work ``Fᵀ J
    dq``; torques that do the same work, ``tauᵀ dq``, are ``tau = Jᵀ F``. An external force F on the
    arm acts on a joint with tau, so the joint needs -tau to hold it; to press on something with F,
    the joint needs tau. The weight of the arm itself is not included.

    Args:
        chain: The arm.
        q: The posture (dof,), rad or m.
        force_n: The force (3,), newtons, base frame; a suspended mass m pulls with
            (0, 0, -9.81 m).
        moment_nm: An additional moment (3,) on the link, newton metres, base frame.
        frame: Name of the link on which the force acts; the tip if None.
        offset_m: The point (3,) in that link's coordinates, metres; the link's origin if None.

    Returns:
        tau (dof,): newton metres, newtons for a prismatic joint; positive towards increasing q.

    Raises:
        BadValueError: A shape is wrong or a number is not finite.
        UnknownNameError: There is no link named ``frame``.
    """
    wrench = np.concatenate(
        [finite_vector(force_n, 3, "The force"), finite_vector(moment_nm, 3, "The moment")]
    )
    J = chain.jacobian(finite_vector(q, chain.dof, "q"), frame, offset_m)
    tau: Vector = J.T @ wrench
    return tau
