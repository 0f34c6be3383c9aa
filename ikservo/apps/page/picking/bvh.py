"""Link shapes for picking, and their bounding volume hierarchy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ikservo.kinematics.arrays import Matrix
from ikservo.kinematics.capsules import Capsule
from ikservo.model.collision_model import capsules_of
from ikservo.model.model import Obstacle

__all__ = [
    "CAPSULE",
    "COUNT",
    "FIRST",
    "LEFT",
    "RIGHT",
    "ROW_WIDTH",
    "TRIANGLE",
    "BvhForest",
    "bounding_boxes",
    "build_bvh",
    "capsule_rows",
    "capsules_of",
    "link_primitives",
    "object_primitives",
    "triangle_rows",
]


# A primitive is a row: its type, then two points and a radius, or three corners.
ROW_WIDTH = 10
CAPSULE, TRIANGLE = 0.0, 1.0
_KIND, _A, _B, _C, _RADIUS = 0, slice(1, 4), slice(4, 7), slice(7, 10), 7


def link_primitives(capsules: Sequence[Capsule]) -> Mapping[str, Matrix]:
    """Compute the primitives (n, ROW_WIDTH) of each link."""
    links = dict.fromkeys(capsule.link for capsule in capsules)
    return {
        link: capsule_rows(
            np.array([c.start_m for c in capsules if c.link == link]),
            np.array([c.end_m for c in capsules if c.link == link]),
            np.array([c.radius_m for c in capsules if c.link == link]),
        )
        for link in links
    }


def capsule_rows(starts_m: Matrix, ends_m: Matrix, radii_m: Matrix) -> Matrix:
    """Return capsules (n, ROW_WIDTH) from (n, 3), (n, 3), (n,); a sphere if both ends coincide."""
    rows = np.zeros((len(starts_m), ROW_WIDTH))
    rows[:, _KIND], rows[:, _RADIUS] = CAPSULE, radii_m
    rows[:, _A], rows[:, _B] = starts_m, ends_m
    return rows


def triangle_rows(corners_m: Matrix) -> Matrix:
    """Return triangles (n, ROW_WIDTH) from their corners (n, 3, 3); both sides are visible."""
    rows = np.zeros((len(corners_m), ROW_WIDTH))
    rows[:, _KIND] = TRIANGLE
    rows[:, _A], rows[:, _B], rows[:, _C] = corners_m[:, 0], corners_m[:, 1], corners_m[:, 2]
    return rows


def object_primitives(things: Sequence[Obstacle]) -> Mapping[str, Matrix]:
    """Compute the primitives (n, ROW_WIDTH) of the upright box around each thing, base frame."""
    return {each.name: _box_rows(np.array([each.low_m, each.high_m])) for each in things}


def _box_rows(ends_m: Matrix) -> Matrix:
    """Compute the twelve triangles of an axis-aligned box from its corners (2, 3)."""
    corners = np.array([[ends_m[index, axis] for axis, index in enumerate(each)] for each in _BITS])
    halves = [half for a, b, c, d in _FACES for half in ((a, b, c), (a, c, d))]
    return triangle_rows(corners[halves])


_BITS = tuple(np.ndindex(2, 2, 2))
# The corners of a box's faces, in order around each face.
_FACES = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))


def bounding_boxes(rows: Matrix) -> Matrix:
    """Compute the axis-aligned box (n, 6) of each primitive: low corner, high corner."""
    a, b = rows[:, _A], rows[:, _B]
    low, high = np.minimum(a, b), np.maximum(a, b)
    is_triangle = rows[:, _KIND] == TRIANGLE
    c = np.where(is_triangle[:, None], rows[:, _C], a)
    more = np.where(is_triangle, 0.0, rows[:, _RADIUS])[:, None]
    return np.hstack([np.minimum(low, c) - more, np.maximum(high, c) + more])


# A node's columns: its children, or its primitives if COUNT is above zero.
LEFT, RIGHT, FIRST, COUNT = 0, 1, 2, 3

_LEAF = 4
_MARGIN_M = 1e-9  # so that rounding does not lose shapes on the face of their box

Nodes = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class BvhForest:
    """One bounding volume tree per link, all in the same arrays.

    Attributes:
        links: Names of the links.
        roots: The root node (links,) of each link's tree.
        boxes: Low and high corner of each node (nodes, 6), link coordinates, metres.
        nodes: See ``LEFT``, ``RIGHT``, ``FIRST``, ``COUNT`` (nodes, 4).
        rows: The primitives (n, ROW_WIDTH), those of a leaf contiguous.
        names: The index of each primitive in its link's shapes (n,).
    """

    links: tuple[str, ...]
    roots: NDArray[np.int64]
    boxes: Matrix
    nodes: Nodes
    rows: Matrix
    names: NDArray[np.int64]


def build_bvh(shapes: Mapping[str, Matrix]) -> BvhForest:
    """Build the trees over the primitives (n, ROW_WIDTH) of each link that has any."""
    trees = {link: _BvhTree(rows) for link, rows in shapes.items() if len(rows)}
    sizes = [len(tree.boxes) for tree in trees.values()]
    counts = [len(tree.order) for tree in trees.values()]
    roots, firsts = (np.cumsum([0, *numbers])[:-1].astype(np.int64) for numbers in (sizes, counts))
    nodes = [
        np.array(tree.nodes, dtype=np.int64) + np.array([root, root, first, 0])
        for tree, root, first in zip(trees.values(), roots, firsts, strict=True)
    ]
    return BvhForest(
        links=tuple(trees),
        roots=roots,
        boxes=np.vstack([np.zeros((0, 6)), *(tree.boxes for tree in trees.values())]),
        nodes=np.vstack([np.zeros((0, 4), dtype=np.int64), *nodes]),
        rows=np.vstack([np.zeros((0, ROW_WIDTH)), *(shapes[k][t.order] for k, t in trees.items())]),
        names=np.concatenate([np.zeros(0, np.int64), *(t.order for t in trees.values())]),
    )


class _BvhTree:
    """Splits the primitives along the longest side until a leaf has few."""

    def __init__(self, rows: Matrix) -> None:
        self.order = np.arange(len(rows), dtype=np.int64)
        self.boxes: list[Matrix] = []
        self.nodes: list[list[int]] = []
        self._boxes = bounding_boxes(rows)
        self._centres = 0.5 * (self._boxes[:, :3] + self._boxes[:, 3:])
        pending = [(0, len(rows), -1, LEFT)]
        while pending:
            pending += self._add_node(*pending.pop())

    def _add_node(
        self, low: int, high: int, parent: int, side: int
    ) -> list[tuple[int, int, int, int]]:
        """Add the node of ``order[low:high]``; return its halves, still to be added."""
        node, own = len(self.nodes), self.order[low:high]
        if parent >= 0:
            self.nodes[parent][side] = node
        corners = self._boxes[own]
        self.boxes.append(
            np.concatenate([corners[:, :3].min(axis=0), corners[:, 3:].max(axis=0)])
            + _MARGIN_M * np.array([-1, -1, -1, 1, 1, 1])
        )
        if high - low <= _LEAF:
            self.nodes.append([0, 0, low, high - low])
            return []
        self.nodes.append([0, 0, 0, 0])
        middle = (low + high) // 2
        axis = int(np.argmax(np.ptp(self._centres[own], axis=0)))
        halves = np.argpartition(self._centres[own, axis], middle - low)
        self.order[low:high] = own[halves]
        return [(low, middle, node, LEFT), (middle, high, node, RIGHT)]
