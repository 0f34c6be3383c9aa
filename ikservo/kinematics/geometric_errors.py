"""Geometric errors of a chain and their Jacobian, for kinematic calibration.

No two arms agree to a millimetre, because links are printed, screws have backlash and bases are
slightly tilted. ``GeometricErrors`` contains these errors; ``apply_geometric_errors`` builds the
chain of an arm with such errors.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from ikservo.kinematics.arrays import FrozenArrays, Matrix, Vector
from ikservo.kinematics.chain import Chain
from ikservo.kinematics.joints import JointType
from ikservo.kinematics.se3 import exp_so3, make_pose, skew


@dataclass(frozen=True, slots=True, eq=False)
class GeometricErrors(FrozenArrays):
    """Small corrections to the described geometry of an arm.

    Attributes:
        base_m: Position of the described base (3,), metres, world coordinates.
        base_rad: Rotation vector (3,) of the described base.
        origins_m: Translation (3,) of a joint's origin from its described place, by joint, metres,
            in the coordinates of the parent link; the entry of the fixed joint before the tip
            corrects the tool.
    """

    base_m: Vector = field(default_factory=lambda: np.zeros(3))
    base_rad: Vector = field(default_factory=lambda: np.zeros(3))
    origins_m: Mapping[str, Vector] = field(default_factory=dict[str, Vector])


def apply_geometric_errors(chain: Chain, geometry: GeometricErrors) -> Chain:
    """Apply geometric errors to a chain."""
    joints = {
        step.joint.name: step.joint for link in chain.frames for step in chain.joints_to(link)
    }
    origins: dict[str, Matrix] = {}
    for name, joint in joints.items():
        origin = joint.origin.copy()
        origin[:3, 3] += geometry.origins_m.get(name, 0.0)
        if joint.parent == chain.base:
            origin = make_pose(geometry.base_m, exp_so3(geometry.base_rad)) @ origin
        origins[name] = origin
    return chain.with_origins(origins)


def identifiable_origins(chain: Chain) -> tuple[str, ...]:
    """Return the joints with identifiable origins: all moving joints except the first.

    The fixed joint at the end of the path to the tip, if any, comes last; it places the tool.
    """
    moving = [step for step in chain.joints_to() if step.scale]
    names = [after.joint.name for _, after in pairwise(moving)]
    last = chain.joints_to()[-1].joint
    return (*names, last.name) if last.kind is JointType.FIXED else tuple(names)


def calibration_jacobian(
    chain: Chain, q: Matrix, geometry: GeometricErrors, origins: Sequence[str]
) -> tuple[Matrix, Matrix]:
    """Compute the tips of a corrected chain and their Jacobian for joints, base and origins.

    Args:
        chain: The chain of the description.
        q: Joint vectors (n, dof).
        geometry: The errors of the arm.
        origins: The joints whose origins are included, see ``identifiable_origins``.

    Returns:
        The tips (n, 3), metres, and J (n, 3, dof + 6 + 3 len(origins)): columns of the joints,
        the base's position and rotation vector, and each origin.
    """
    own = apply_geometric_errors(chain, geometry)
    T, jacobian = own.forward_and_jacobian(q)
    tips: Matrix = T[:, :3, 3]
    # An origin moves the tip in the coordinates of its joint's parent link.
    parents = {step.joint.name: step.joint.parent for step in own.joints_to()}
    links = own.link_poses(q)
    origin_columns = [links[parents[name]][:, :3, :3] for name in origins]
    eye = np.broadcast_to(np.eye(3), (len(q), 3, 3))
    # The derivative by the base's rotation vector uses the left Jacobian of small rotations.
    W = skew(geometry.base_rad)
    left_jacobian = np.eye(3) + W / 2.0 + W @ W / 6.0 + W @ W @ W / 24.0
    arms_m = tips - geometry.base_m
    rotation_columns = np.array([-skew(arm) @ left_jacobian for arm in arms_m])
    columns = [jacobian[:, :3, :], eye, rotation_columns, *origin_columns]
    return tips, np.concatenate(columns, axis=2)
