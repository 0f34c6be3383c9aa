"""Boxes around boxes around shapes: a tree in link coordinates, built once (lecture L16)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ikservo.kinematics.se3 import Matrix
from ikservo.view.pick.shapes import WIDTH, boxes_around

__all__ = ["COUNT", "FIRST", "LEFT", "RIGHT", "Forest", "plant"]

# A node's columns: its children, or which primitives it holds where COUNT is above zero.
LEFT, RIGHT, FIRST, COUNT = 0, 1, 2, 3

_LEAF = 4
_SPARE_M = 1e-9  # what lies on the very face of its box is not lost to rounding

Nodes = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Forest:
    """A tree for each link, all in the same arrays.

    Attributes:
        links: Names of the links.
        roots: The node (links,) that each link's tree begins with.
        boxes: Low and high corner of each node (nodes, 6), link coordinates, metres.
        nodes: See ``LEFT``, ``RIGHT``, ``FIRST``, ``COUNT`` (nodes, 4).
        rows: The primitives (n, WIDTH), those of a leaf side by side.
        names: The place that each of them had in its link's shapes (n,).
    """

    links: tuple[str, ...]
    roots: NDArray[np.int64]
    boxes: Matrix
    nodes: Nodes
    rows: Matrix
    names: NDArray[np.int64]


def plant(shapes: Mapping[str, Matrix]) -> Forest:
    """Build the trees over the primitives (n, WIDTH) of each link; links without any are left."""
    grown = {link: _Tree(rows) for link, rows in shapes.items() if len(rows)}
    sizes = [len(tree.boxes) for tree in grown.values()]
    held = [len(tree.order) for tree in grown.values()]
    roots, firsts = (np.cumsum([0, *numbers])[:-1].astype(np.int64) for numbers in (sizes, held))
    nodes = [
        np.array(tree.nodes, dtype=np.int64) + np.array([root, root, first, 0])
        for tree, root, first in zip(grown.values(), roots, firsts, strict=True)
    ]
    return Forest(
        links=tuple(grown),
        roots=roots,
        boxes=np.vstack([np.zeros((0, 6)), *(tree.boxes for tree in grown.values())]),
        nodes=np.vstack([np.zeros((0, 4), dtype=np.int64), *nodes]),
        rows=np.vstack([np.zeros((0, WIDTH)), *(shapes[k][t.order] for k, t in grown.items())]),
        names=np.concatenate([np.zeros(0, np.int64), *(t.order for t in grown.values())]),
    )


class _Tree:
    """Halves the primitives along the longest side until few are left."""

    def __init__(self, rows: Matrix) -> None:
        self.order = np.arange(len(rows), dtype=np.int64)
        self.boxes: list[Matrix] = []
        self.nodes: list[list[int]] = []
        self._around = boxes_around(rows)
        self._middles = 0.5 * (self._around[:, :3] + self._around[:, 3:])
        waiting = [(0, len(rows), -1, LEFT)]
        while waiting:
            waiting += self._grow(*waiting.pop())

    def _grow(self, low: int, high: int, parent: int, side: int) -> list[tuple[int, int, int, int]]:
        """Add the node of ``order[low:high]``; return the halves that wait below it."""
        node, mine = len(self.nodes), self.order[low:high]
        if parent >= 0:
            self.nodes[parent][side] = node
        corners = self._around[mine]
        self.boxes.append(
            np.concatenate([corners[:, :3].min(axis=0), corners[:, 3:].max(axis=0)])
            + _SPARE_M * np.array([-1, -1, -1, 1, 1, 1])
        )
        if high - low <= _LEAF:
            self.nodes.append([0, 0, low, high - low])
            return []
        self.nodes.append([0, 0, 0, 0])
        middle = (low + high) // 2
        along = int(np.argmax(np.ptp(self._middles[mine], axis=0)))
        halves = np.argpartition(self._middles[mine, along], middle - low)
        self.order[low:high] = mine[halves]
        return [(low, middle, node, LEFT), (middle, high, node, RIGHT)]
