"""Upper bounds on how far links move while joints move by a given amount."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ikservo.kinematics.arrays import Vector
from ikservo.kinematics.capsules import Capsule
from ikservo.kinematics.chain import Chain
from ikservo.kinematics.joints import ChainJoint, JointType

__all__ = ["LinkTravelBounds"]


class LinkTravelBounds:
    """Bounds the way of every point of a link's capsules for each unit of a joint.

    A point goes no further than the angle times its distance from the joint's axis, which is no
    more than the lengths of the links in between.

    Args:
        chain: The arm; its limits bound the slides between.
        capsules: Of all links.
    """

    def __init__(self, chain: Chain, capsules: Sequence[Capsule]) -> None:
        self._chain = chain
        self._size_m: dict[str, float] = {}
        for capsule in capsules:
            ends_m = np.linalg.norm([capsule.start_m, capsule.end_m], axis=1)
            size_m = self._size_m.get(capsule.link, 0.0)
            self._size_m[capsule.link] = max(size_m, float(ends_m.max()))

    def bound_of(self, link: str) -> Vector:
        """Return the bound for a link (dof,), m/rad or m/m."""
        return self._sum_steps(link, self._chain.joints_to(link))

    def relative_bound(self, a: str, b: str) -> Vector:
        """Return by how much two links come nearer (dof,): joints that carry both do not count."""
        ways = self._chain.joints_to(a), self._chain.joints_to(b)
        shared = {step.joint.name for step in ways[0]} & {step.joint.name for step in ways[1]}
        own = [[step for step in way if step.joint.name not in shared] for way in ways]
        return self._sum_steps(a, own[0]) + self._sum_steps(b, own[1])

    def _sum_steps(self, link: str, steps: Sequence[ChainJoint]) -> Vector:
        reach_m, length_m = np.zeros(self._chain.dof), self._size_m.get(link, 0.0)
        for step in reversed(steps):
            slides = step.joint.kind is JointType.PRISMATIC
            reach_m[step.column] += abs(step.scale) * (1.0 if slides else length_m)
            length_m += float(np.linalg.norm(step.joint.origin[:3, 3]))
            length_m += self._max_slide_offset_m(step) if slides else 0.0
        return reach_m

    def _max_slide_offset_m(self, step: ChainJoint) -> float:
        """Return how far a slide stands from its origin at most."""
        if not step.scale:
            return abs(step.shift)
        ends = self._chain.lower_rad[step.column], self._chain.upper_rad[step.column]
        return max(abs(step.scale * float(end) + step.shift) for end in ends)
