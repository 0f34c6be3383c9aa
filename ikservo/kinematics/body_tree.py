"""Moving bodies of a chain as stacked arrays: their poses and the twists of their joints.

A body is a link that a joint of q moves, with all links that are fixed to it. Links that q does not
move (such as the jaws of a gripper, which are not on the path to the tip) are fixed to the body
that carries them. The first axis of all arrays is the body, parents first, the second axis the
sample.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ikservo.kinematics.arrays import Matrix, read_only
from ikservo.kinematics.chain import Chain
from ikservo.kinematics.joints import ChainJoint, JointType

BASE = -1


@dataclass(frozen=True, slots=True, eq=False)
class BodyTree:
    """Constants of n moving bodies, independent of q, from which their motion is computed.

    Attributes:
        names: For each body, the link whose frame is used as the frame of the body.
        links: For each link of the chain, its body (BASE if it does not move) and its pose
            T_body_link (4, 4).
        parents: The body to which each body is attached, or BASE.
        carries: 1 if body j is body i or carries it, else 0 (n, n).
        gears: Multipliers (n, dof) in the values ``gears @ q + shifts``, mimic joints included.
        shifts: Offsets of the values (n, 1), rad or m.
        slides: Whether each joint is prismatic (n, 1).
        poses_still: The part of T_parent_body (n, 1, 4, 4) that does not depend on q.
        poses_sine: The part that is multiplied by the sine of the value, or by the value itself for
            a prismatic joint (n, 1, 4, 4).
        poses_cosine: The part that is multiplied by the cosine (n, 1, 4, 4).
        body_twists: The twist of each joint in its body's frame (n, 1, 4, 4).
    """

    names: tuple[str, ...]
    links: Mapping[str, tuple[int, Matrix]]
    parents: tuple[int, ...]
    carries: Matrix
    gears: Matrix
    shifts: Matrix
    slides: NDArray[np.bool_]
    poses_still: Matrix
    poses_sine: Matrix
    poses_cosine: Matrix
    body_twists: Matrix

    @classmethod
    def of(cls, chain: Chain) -> BodyTree:
        """Make the body tree of a chain."""
        links, joints = _place_links(chain)
        steps, parents = [joint.step for joint in joints], tuple(joint.parent for joint in joints)
        twists = np.array([step.twist_matrix for step in steps])
        T = np.array([joint.T_parent_joint for joint in joints])
        carries = np.eye(len(parents))
        for body, parent in enumerate(parents):
            if parent != BASE:
                carries[body] += carries[parent]
        return cls(
            names=tuple(step.joint.child for step in steps),
            links=links,
            parents=parents,
            carries=read_only(carries),
            gears=read_only([step.scale * np.eye(chain.dof)[step.column] for step in steps]),
            shifts=read_only([[step.shift] for step in steps]),
            slides=np.array([[step.joint.kind is JointType.PRISMATIC] for step in steps]),
            poses_still=read_only((T + T @ twists @ twists)[:, None]),
            poses_sine=read_only((T @ twists)[:, None]),
            poses_cosine=read_only((-T @ twists @ twists)[:, None]),
            body_twists=read_only(twists[:, None]),
        )

    def poses(self, q: Matrix) -> Matrix:
        """Compute T_base_body (n, samples, 4, 4) at q (samples, dof).

        ``T_base_body = T_base_parent T_parent_joint exp(value * twist)`` by Rodrigues' formula.
        """
        values = self.gears @ q.T + self.shifts
        sines = np.where(self.slides, values, np.sin(values))[..., None, None]
        cosines = np.cos(values)[..., None, None]
        T: Matrix = self.poses_still + sines * self.poses_sine + cosines * self.poses_cosine
        for body, parent in enumerate(self.parents):
            if parent != BASE:
                T[body] = T[parent] @ T[body]
        return T

    def twists(self, T: Matrix) -> Matrix:
        """Compute the twist D (n, samples, 4, 4) of each joint in the base frame.

        A small change of the joint's value moves each point x (4,) that the joint carries by ``D
        x``: ``D = T twist T⁻¹``.
        """
        D = np.zeros(T.shape)
        moved = T @ self.body_twists
        D[..., :3, :3] = moved[..., :3, :3] @ T[..., :3, :3].swapaxes(-1, -2)
        D[..., :3, 3:] = moved[..., :3, 3:] - D[..., :3, :3] @ T[..., :3, 3:]
        return D

    def sum_to_tips(self, X: Matrix) -> Matrix:
        """Return the sum of X (n, …) over each body and all bodies that carry it."""
        return (self.carries @ X.reshape(len(X), -1)).reshape(X.shape)

    def sum_to_base(self, X: Matrix) -> Matrix:
        """Return the sum of X (n, …) over each body and all bodies that it carries."""
        return (self.carries.T @ X.reshape(len(X), -1)).reshape(X.shape)

    def joint_rates(self, qd: Matrix) -> Matrix:
        """Compute the rates (n, samples, 1, 1) of all joints at the rates (samples, dof) of q."""
        return (self.gears @ qd.T)[..., None, None]


class _MovingJoint(NamedTuple):
    step: ChainJoint
    parent: int
    T_parent_joint: Matrix


def _place_links(chain: Chain) -> tuple[dict[str, tuple[int, Matrix]], list[_MovingJoint]]:
    """Compute each link's body and its pose in that body, and the joint of each body."""
    links: dict[str, tuple[int, Matrix]] = {chain.base: (BASE, read_only(np.eye(4)))}
    joints: list[_MovingJoint] = []
    for link in chain.frames[1:]:
        step = chain.joints_to(link)[-1]
        parent, T_parent_link = links[step.joint.parent]
        T_parent_joint = T_parent_link @ step.joint.origin
        if step.scale and step.joint.kind is not JointType.FIXED:
            links[link] = len(joints), read_only(np.eye(4))
            joints.append(_MovingJoint(step, parent, T_parent_joint))
        else:
            links[link] = parent, read_only(T_parent_joint @ step.motion_at(step.shift))
    return links, joints
