"""A text drawing of an arm with its joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

from ikservo.model import Model

_COLUMNS, _ROWS = 46, 13
_ASPECT = 2.0  # a character is twice as high as it is wide
_MARK, _JOINT, _LINK = "@", "o", "."

Point = tuple[float, float]
Cell = tuple[int, int]


def ascii_sketch(model: Model, joint: str, pose: str = "home") -> list[str]:
    """Draw a side view in a named pose: ``@`` the joint, ``o`` the others; return its lines.

    Raises:
        UnknownNameError: The arm has no such pose.
    """
    points_by_joint = _joint_points(model, pose)
    points = [(0.0, 0.0), *points_by_joint.values()]
    cells = _AsciiCanvas(points)
    for start, end in pairwise(points):
        cells.draw(start, end)
    for name, point in points_by_joint.items():
        cells.put(point, _MARK if name == joint else _JOINT)
    cells.put(points_by_joint[joint], _MARK)
    return [*cells.lines(), "=" * _COLUMNS, f"{_MARK} {joint}"]


def _joint_points(model: Model, pose: str) -> dict[str, Point]:
    """Compute every joint's radius and height, metres; a gripper is drawn at the tip."""
    q = model.chain_pose(pose)
    children = {joint.name: joint.child for joint in model.urdf.joints}
    frames = set(model.chain.frames)
    points_by_joint: dict[str, Point] = {}
    for joint in model.joints:
        child = children[joint.name]
        T = model.chain.forward(q, frame=child if child in frames else None)
        points_by_joint[joint.name] = (float(T[0, 3] ** 2 + T[1, 3] ** 2) ** 0.5, float(T[2, 3]))
    return points_by_joint


class _AsciiCanvas:
    """A grid of characters, scaled to the drawing."""

    def __init__(self, points: Sequence[Point]) -> None:
        self._cells: dict[Cell, str] = {}
        self._left = min(x for x, _ in points)
        self._floor = min(z for _, z in points)
        wide = max(x for x, _ in points) - self._left
        high = max(z for _, z in points) - self._floor
        self._step_m = max(wide / (_COLUMNS - 1), _ASPECT**-1 * high / (_ROWS - 1), 1e-6)

    def put(self, point: Point, character: str) -> None:
        self._cells[self._to_cell(point)] = character

    def draw(self, start: Point, end: Point) -> None:
        (x0, y0), (x1, y1) = self._to_cell(start), self._to_cell(end)
        steps = max(abs(x1 - x0), abs(y1 - y0), 1)
        for k in range(steps + 1):
            cell = round(x0 + (x1 - x0) * k / steps), round(y0 + (y1 - y0) * k / steps)
            self._cells.setdefault(cell, _LINK)

    def lines(self) -> list[str]:
        top = max(y for _, y in self._cells)
        return [self._render_line(self._cells, y) for y in range(top, -1, -1)]

    @staticmethod
    def _render_line(cells: Mapping[Cell, str], row: int) -> str:
        return "".join(cells.get((column, row), " ") for column in range(_COLUMNS)).rstrip()

    def _to_cell(self, point: Point) -> Cell:
        x, z = point
        column = (x - self._left) / self._step_m
        row = (z - self._floor) / self._step_m / _ASPECT
        return round(column), round(row)
