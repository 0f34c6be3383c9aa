"""Collision bodies: the capsule pairs to check, and their distances."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ikservo.kinematics.arrays import FrozenArrays, Matrix, Vector
from ikservo.kinematics.capsules import Capsule, segment_distance
from ikservo.kinematics.chain import Chain
from ikservo.kinematics.joints import ChainJoint, JointType
from ikservo.kinematics.packed import PackedBody, pack_capsules, pack_links

# Margin [m], because an arm is never exactly in a named pose.
_MARGIN_M = 0.004


class LinkTravelBounds:
    """Bounds on the motion of any point of a link's capsules, per unit of each joint.

    A point moves by at most the joint's angle times the point's distance from the axis. This
    distance is known for the joint that carries the link itself; for earlier joints it is at most
    the sum of the lengths up to that joint. Limits of the chain bound the travel of prismatic
    joints in between.
    """

    def __init__(self, chain: Chain, capsules: Sequence[Capsule]) -> None:
        self._chain, self._points_m = chain, dict[str, Matrix]()
        for capsule in capsules:
            known_m = self._points_m.get(capsule.link, np.zeros((0, 3)))
            self._points_m[capsule.link] = np.vstack([known_m, capsule.start_m, capsule.end_m])

    def bound_of(self, link: str) -> Vector:
        """Return the bound of a link (dof,), m/rad or m/m."""
        return self._sum_steps(link, self._chain.joints_to(link), ())

    def relative_bound(self, a: str, b: str) -> Vector:
        """Bound how far each joint (dof,) can bring two links closer; 0 for joints that move both.

        Either link may be considered at rest.
        """
        paths = self._chain.joints_to(a), self._chain.joints_to(b)
        common = {step.joint.name for step in paths[0]} & {step.joint.name for step in paths[1]}
        to_a, to_b = ([s for s in path if s.joint.name not in common] for path in paths)
        return np.minimum(self._sum_steps(a, to_a, to_b), self._sum_steps(b, to_b, to_a))

    def _sum_steps(
        self, link: str, inwards: Sequence[ChainJoint], outwards: Sequence[ChainJoint]
    ) -> Vector:
        """Sum the bounds of the joints from a link to the fork, and from there to another link."""
        reach_m, points_m = np.zeros(self._chain.dof), self._points_m.get(link, np.zeros((1, 3)))
        length_m = float(np.linalg.norm(points_m, axis=1).max())
        is_known = True  # whether the points are known in the present frame
        for step, leads_out in [
            *((step, False) for step in reversed(inwards)), *((step, True) for step in outwards)
        ]:  # fmt: skip
            R, p_m = step.joint.origin[:3, :3], step.joint.origin[:3, 3]
            if leads_out:
                points_m = (points_m - p_m) @ R
                length_m = _farthest(points_m, is_known, length_m + float(np.linalg.norm(p_m)))
            slides = step.joint.kind is JointType.PRISMATIC
            aside_m = np.cross(points_m, step.joint.axis)
            arm_m = 1.0 if slides else _farthest(aside_m, is_known, length_m)
            reach_m[step.column] += abs(step.scale) * arm_m
            length_m += self._max_slide_offset_m(step) if slides else 0.0
            is_known &= step.joint.kind is JointType.FIXED
            if not leads_out:
                points_m = points_m @ R.T + p_m
                length_m = _farthest(points_m, is_known, length_m + float(np.linalg.norm(p_m)))
        return reach_m

    def _max_slide_offset_m(self, step: ChainJoint) -> float:
        """Compute the maximum offset of a prismatic joint from its origin."""
        if not step.scale:
            return abs(step.shift)
        ends = self._chain.lower_rad[step.column], self._chain.upper_rad[step.column]
        return max(abs(step.scale * float(end) + step.shift) for end in ends)


def _farthest(points_m: Matrix, is_known: bool, otherwise_m: float) -> float:
    return float(np.linalg.norm(points_m, axis=1).max()) if is_known else otherwise_m


@dataclass(frozen=True, slots=True, eq=False)
class PairDistances(FrozenArrays):
    """Distances of pairs, of links or of a link and an obstacle, in several postures.

    Attributes:
        pairs: The names of each pair: a link, and another link or an obstacle.
        gap_m: Distances between their surfaces (n, pairs), metres; negative if they overlap.
    """

    pairs: tuple[tuple[str, str], ...]
    gap_m: Matrix


class CollisionBody:
    """The capsules of all links, and the pairs of links whose distances are checked.

    Links that are joined to each other touch by design, and their pairs are left out. Capsules are
    thicker than the parts that they cover: if a pair overlaps in a posture known to be free, its
    distance in this posture counts as zero.

    Args:
        chain: The arm, whose joints ``q`` (dof,) determine the poses of the links.
        capsules: The capsules; a link may have any number of them.
        postures: Joint vectors (dof,) that are known to be free of collision.
    """

    def __init__(
        self, chain: Chain, capsules: Sequence[Capsule], postures: Sequence[ArrayLike] = ()
    ) -> None:
        self.chain = chain
        self._capsules = sorted(capsules, key=lambda capsule: capsule.link)
        self._radii_m = np.array([capsule.radius_m for capsule in self._capsules])
        self._links = list(dict.fromkeys(capsule.link for capsule in self._capsules))
        moving: dict[str, frozenset[str]] = {}
        for link in self._links:
            joints = [step.joint for step in chain.joints_to(link)]
            moving[link] = frozenset(j.name for j in joints if j.kind is not JointType.FIXED)
        # Two links with one moving joint between them are joined to each other.
        pairs = itertools.combinations(self._links, 2)
        self.pairs = tuple((a, b) for a, b in pairs if len(moving[a] ^ moving[b]) > 1)
        self._ones, self._others, self._first = self._capsule_pairs()
        self._overlap_m = np.zeros(len(self.pairs))
        if len(postures):
            nearest_m = self.link_distances(np.array(postures)).gap_m.min(axis=0)
            self._overlap_m = np.maximum(_MARGIN_M - nearest_m, 0.0)

    def with_attached(self, name: str, link: str, capsules: Sequence[Capsule]) -> CollisionBody:
        """Return the body with a thing fixed to one of its links.

        The thing may touch that link, and the links that a single joint connects to that link. Its
        capsules are in coordinates of the link; their ``link`` is the thing's name.
        """
        body = CollisionBody(self.chain.with_frame(name, link), [*self._capsules, *capsules])
        overlaps = dict(zip(self.pairs, self._overlap_m.tolist(), strict=True))
        body._overlap_m = np.array([overlaps.get(pair, 0.0) for pair in body.pairs])
        return body

    def link_distances(self, q: ArrayLike) -> PairDistances:
        """Compute the distance between the links of each checked pair, for q (n, dof)."""
        starts, ends = self._capsule_ends(q)
        i, j = self._ones, self._others
        distance = segment_distance(starts[:, i], ends[:, i], starts[:, j], ends[:, j])
        gap_m = np.minimum.reduceat(
            distance - self._radii_m[i] - self._radii_m[j], self._first, axis=1
        )
        return PairDistances(self.pairs, gap_m + self._overlap_m)

    def floor_distances(self, q: ArrayLike, height_m: float) -> PairDistances:
        """Return the height above the table of each link except the root, for q (n, dof)."""
        starts, ends = self._capsule_ends(q)
        lowest = np.minimum(starts[..., 2], ends[..., 2]) - self._radii_m - height_m
        return self._min_by_link(lowest, "the table")

    def pack(self) -> PackedBody:
        """Pack the body into arrays of numbers, which are shared and must not be changed."""
        return self._packed

    @cached_property
    def _packed(self) -> PackedBody:
        names, links = pack_links(self.chain)
        reach = LinkTravelBounds(self.chain, self._capsules)
        pair = np.searchsorted(self._first, np.arange(len(self._ones)), side="right") - 1
        return PackedBody(
            base=self.chain.base,
            dof=self.chain.dof,
            names=names,
            links=links,
            capsules=pack_capsules(self._capsules, names),
            pairs=self.pairs,
            rows=np.stack([self._ones, self._others, pair], axis=1).astype(np.float64),
            overlap_m=self._overlap_m,
            reach_m=np.array([reach.bound_of(name) for name in names]),
            pair_reach_m=np.array([reach.relative_bound(a, b) for a, b in self.pairs]).reshape(
                len(self.pairs), self.chain.dof
            ),
        )

    def _capsule_ends(self, q: ArrayLike) -> tuple[Matrix, Matrix]:
        """Return both ends (n, capsules, 3) of every capsule in world coordinates."""
        poses = self.chain.link_poses(q)
        ends = [capsule.ends(poses[capsule.link]) for capsule in self._capsules]
        return np.stack([a for a, _ in ends], axis=1), np.stack([b for _, b in ends], axis=1)

    def _min_by_link(self, gap_m: Matrix, other: str) -> PairDistances:
        """Return the minimum distance over the capsules of each link except the root."""
        owners = [capsule.link for capsule in self._capsules]
        first = [owners.index(link) for link in self._links]
        per_link = np.minimum.reduceat(gap_m, first, axis=1)
        moving = [i for i, link in enumerate(self._links) if link != self.chain.base]
        return PairDistances(tuple((self._links[i], other) for i in moving), per_link[:, moving])

    def _capsule_pairs(self) -> tuple[list[int], list[int], list[int]]:
        """Return the capsules to compare, grouped by pair of links, and the start of each group."""
        own: dict[str, list[int]] = {}
        for i, capsule in enumerate(self._capsules):
            own.setdefault(capsule.link, []).append(i)
        ones: list[int] = []
        others: list[int] = []
        first: list[int] = []
        for a, b in self.pairs:
            first.append(len(ones))
            for i, j in itertools.product(own[a], own[b]):
                ones.append(i)
                others.append(j)
        return ones, others, first
