"""The arm as a body: its capsules where the joints put them, and what comes near what."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from numpy.typing import ArrayLike

from ikservo.kinematics.capsules import Capsule, capsule_distance, segment_box_distance
from ikservo.kinematics.chain import Chain
from ikservo.kinematics.joints import JointKind
from ikservo.kinematics.se3 import Vector

__all__ = ["Body", "Nearness"]

# An arm never stands in a named pose to the tick.
_SLACK_M = 0.004

_Placed = tuple[tuple[Vector, Vector], float]
_Gap = Callable[[Vector, Vector, float], float]


@dataclass(frozen=True, slots=True)
class Nearness:
    """How close two things come.

    Attributes:
        gap_m: Distance between their surfaces, metres; negative where they overlap.
        link: A link of the arm.
        other: Another link, or the name of what it comes near.
    """

    gap_m: float
    link: str
    other: str


class Body:
    """The capsules of all links, and the pairs of links that may come near each other.

    Links that are joined to each other touch by nature and are left out. Capsules are thicker
    than what they cover: pairs that overlap in a posture known to be free may come as near as
    they are there, and their gap is counted from there.

    Args:
        chain: The arm; ``q`` (dof,) places its links.
        capsules: Any number for each link.
        postures: Joint vectors (dof,) that are known to be free of collision.
    """

    def __init__(
        self, chain: Chain, capsules: Sequence[Capsule], postures: Sequence[ArrayLike] = ()
    ) -> None:
        self._chain = chain
        self._by_link: dict[str, list[Capsule]] = {}
        for capsule in capsules:
            self._by_link.setdefault(capsule.link, []).append(capsule)
        pairs = itertools.combinations(self._by_link, 2)
        self.pairs = tuple(pair for pair in pairs if not _joined(chain, *pair))
        self._overlap_m = dict.fromkeys(self.pairs, 0.0)
        for q in postures:
            self._allow(q)

    def gaps(self, q: ArrayLike) -> list[Nearness]:
        """Return how close each watched pair of links comes at ``q``."""
        placed = self._place(q)
        return [
            Nearness(_pair_gap(placed[a], placed[b]) + self._overlap_m[a, b], a, b)
            for a, b in self.pairs
        ]

    def nearest_pair(self, q: ArrayLike) -> Nearness | None:
        """Return the two links that come closest at ``q``; None where no pair is watched."""
        return min(self.gaps(q), key=_gap_m, default=None)

    def lowest(self, q: ArrayLike) -> Nearness:
        """Return the link that comes closest to the plane z = 0 from above, the root left out."""
        return self._over_links(q, _above_floor, "the floor")

    def nearest_to_box(self, q: ArrayLike, low_m: Vector, high_m: Vector, name: str) -> Nearness:
        """Return the link that comes closest to an upright box from low_m to high_m (3,)."""
        return self._over_links(q, _beside_box(low_m, high_m), name)

    def _over_links(self, q: ArrayLike, gap: _Gap, other: str) -> Nearness:
        return min(
            (
                Nearness(gap(*ends, radius_m), link, other)
                for link, placed in self._place(q).items()
                if link != self._chain.base
                for ends, radius_m in placed
            ),
            key=_gap_m,
        )

    def _place(self, q: ArrayLike) -> dict[str, list[_Placed]]:
        """Return every link's capsules in world coordinates."""
        return {
            link: [(capsule.ends(T), capsule.radius_m) for capsule in capsules]
            for link, capsules in self._by_link.items()
            for T in [self._chain.forward(q, link)]
        }

    def _allow(self, q: ArrayLike) -> None:
        """Take how far pairs overlap around ``q`` as nothing to worry about."""
        placed = self._place(q)
        for a, b in self.pairs:
            overlap_m = _SLACK_M - _pair_gap(placed[a], placed[b])
            self._overlap_m[a, b] = max(self._overlap_m[a, b], overlap_m)


def _joined(chain: Chain, a: str, b: str) -> bool:
    """Return whether at most one moving joint lies between two links."""
    ways = [{step.joint.name: step.joint for step in chain.way(link)} for link in (a, b)]
    between = [*(ways[0].keys() ^ ways[1].keys())]
    joints = ways[0] | ways[1]
    return sum(joints[name].kind is not JointKind.FIXED for name in between) <= 1


def _pair_gap(a: Sequence[_Placed], b: Sequence[_Placed]) -> float:
    return min(
        capsule_distance(ends_a, radius_a, ends_b, radius_b)
        for ends_a, radius_a in a
        for ends_b, radius_b in b
    )


def _gap_m(nearness: Nearness) -> float:
    return nearness.gap_m


def _above_floor(a: Vector, b: Vector, radius_m: float) -> float:
    return min(float(a[2]), float(b[2])) - radius_m


def _beside_box(low_m: Vector, high_m: Vector) -> _Gap:
    def gap(a: Vector, b: Vector, radius_m: float) -> float:
        return segment_box_distance(a, b, low_m, high_m) - radius_m

    return gap
