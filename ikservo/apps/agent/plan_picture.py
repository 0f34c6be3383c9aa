"""Draw a plan: the arm before and after, the path of its tip, and the things around the arm.

Two views: from above, and from the side on which the tip moves. Grey: the arm now; blue: the arm at
the end; orange: the path of the tip; red: things around the arm; black: the table.
"""

from __future__ import annotations

import itertools
import struct
import zlib
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from ikservo.apps.agent.tool_results import Point
from ikservo.arm import Arm
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.planning.motion_plan import MotionPlan

Picture = NDArray[np.uint8]
"""A picture: colours (h, w, 3), red first."""

_SIZE = 320  # pixels of each view
_GREY, _BLUE, _ORANGE = (150, 150, 150), (30, 90, 200), (230, 120, 0)
_RED, _BLACK = (200, 40, 40), (0, 0, 0)
_LONGEST_SIDE = 1000  # pixels of a camera's picture; models see no finer ones


def draw_plan(arm: Arm, plan: MotionPlan) -> Picture:
    """Draw a plan as two views side by side."""
    before, after = _skeleton(arm, plan.start), _skeleton(arm, plan.goal)
    steps = plan.sample(max(plan.duration_s / 60.0, 1e-3)).positions
    path = arm.context.planner.tips(steps)
    things = [_edges(each.low_m, each.high_m) for each in arm.scene.things]
    side = plan.tip_m * (1.0, 1.0, 0.0)
    length = float(np.linalg.norm(side))
    along = side / length if length > 1e-6 else np.array([1.0, 0.0, 0.0])
    farthest_m = float(np.abs(np.concatenate([before, after, path])).max())
    corners = [abs(x) for each in arm.scene.things for x in (*each.low_m[:2], *each.high_m[:2])]
    reach = 1.15 * min(max([farthest_m, *corners]), 1.5 * farthest_m)
    x, y, z = np.eye(3)
    views, drawn = ((-y, x), (along, z)), list[Picture]()
    for right, up in views:
        view = _View(np.stack([right, up]), reach)
        for edges in things:
            for start, end in edges:
                view.line(np.stack([start, end]), _RED, 1.0)
        if up[2]:
            view.line(np.array([-reach * along, reach * along]), _BLACK, 0.5)
        view.line(before, _GREY, 3.0)
        view.line(path, _ORANGE, 1.5)
        view.line(after, _BLUE, 3.0)
        drawn.append(view.pixels)
    return np.concatenate(drawn, axis=1)


class _View:
    """A parallel projection onto two axes (2, 3), right and up, with the base in the middle."""

    def __init__(self, axes: Matrix, reach_m: float) -> None:
        self.pixels = np.full((_SIZE, _SIZE, 3), 255, dtype=np.uint8)
        self._axes, self._scale = axes, 0.5 * _SIZE / reach_m
        self._grid = np.stack(np.meshgrid(np.arange(_SIZE), np.arange(_SIZE)), axis=-1) + 0.5

    def line(self, points: Matrix, colour: Sequence[int], half_width_px: float) -> None:
        """Draw a line through points (k, 3)."""
        flat = points @ self._axes.T * self._scale * (1.0, -1.0) + 0.5 * _SIZE
        for a, b in itertools.pairwise(flat):
            along = b - a
            length2 = float(along @ along) or 1.0
            share = np.clip((self._grid - a) @ along / length2, 0.0, 1.0)
            distance = np.linalg.norm(self._grid - a - share[..., None] * along, axis=-1)
            self.pixels[distance <= half_width_px] = colour


def _skeleton(arm: Arm, joints: Vector) -> Matrix:
    """Return the origins (k, 3) of the frames from base to tip."""
    chain = arm.chain
    poses = chain.link_poses(arm.joint_index.chain_joints(joints))
    links = [chain.base, *(each.joint.child for each in chain.joints_to())]
    return np.array([poses[link][:3, 3] for link in links])


def _edges(low_m: Point, high_m: Point) -> Iterator[tuple[Vector, Vector]]:
    """Yield the edges of an upright box."""
    corners = [np.array(each) for each in itertools.product(*zip(low_m, high_m, strict=True))]
    for a, b in itertools.combinations(corners, 2):
        if np.count_nonzero(a != b) == 1:
            yield a, b


def shrink_step(size: tuple[int, int]) -> int:
    """Return the subsampling step in pixels for a camera's picture (width, height)."""
    return -(-max(size) // _LONGEST_SIDE)


def shrunk(picture: NDArray[np.uint8]) -> Picture:
    """Return a camera's picture, in BGR or grey, as a smaller picture in RGB."""
    height, width = picture.shape[:2]
    step = shrink_step((width, height))
    small = picture[::step, ::step]
    return np.repeat(small[..., None], 3, axis=-1) if small.ndim == 2 else small[..., ::-1]


def encode_png(picture: Picture) -> bytes:
    """Encode a picture (h, w, 3) as PNG (RFC 2083)."""
    height, width = picture.shape[:2]
    rows = np.insert(picture.reshape(height, 3 * width), 0, 0, axis=1)
    chunks = (
        (b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)),
        (b"IDAT", zlib.compress(rows.tobytes())),
        (b"IEND", b""),
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
        for name, data in chunks
    )
