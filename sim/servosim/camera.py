"""A camera that sees a simulated arm: the board on its tip is drawn exactly, the rest by MuJoCo."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from servosim.errors import SimulatorError
from servosim.urdf import Matrix
from servosim.world import World

if TYPE_CHECKING:
    from cv2.aruco import CharucoBoard

    from servosim.stage import Stage

PIXELS_PER_SQUARE = 40  # resolution of the board's picture
MARGIN_PX, MARGIN_SHARE = 4.0, 0.1  # margin around the board in pixels, and as a fraction of it
IN_FRONT_M = 0.002  # smallest distance by which something hides the board
BACKGROUND = 150.0  # grey value of the background


def look_at(eye_m: Matrix, point_m: Matrix) -> Matrix:
    """Return T_base_camera (4, 4) at an eye: z towards a point, x to the right, y down."""
    z = (point_m - eye_m) / np.linalg.norm(point_m - eye_m)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3] = np.column_stack([x, np.cross(z, x), z, eye_m])
    return T


@dataclass(frozen=True)
class SimulatedView:
    """A camera, and the mounting of a board on the tip.

    Attributes:
        from_tip_m: The position of the camera relative to the tip in the pose home (3,), base
            frame. A calibration is valid for every start pose.
        aside_m: The distance of the board from the tip, towards the camera.
        tilt_rad: The first tilt of the board away from the camera.
        focal_px: The focal length of the lens.
        off_centre_px: The point where the optical axis meets the picture, relative to the picture's
            centre, right and down.
        distortion: k1 and k2.
        size: Width and height of the pictures.
        noise: Standard deviation of each pixel's value, which is 0 to 255.
    """

    from_tip_m: tuple[float, float, float] = (0.36, 0.14, 0.2)
    aside_m: float = 0.06
    tilt_rad: float = 0.3
    focal_px: float = 900.0
    off_centre_px: tuple[float, float] = (0.0, 0.0)
    distortion: tuple[float, float] = (-0.12, 0.04)
    size: tuple[int, int] = (960, 720)
    noise: float = 2.0

    def lens(self) -> tuple[Matrix, Matrix]:
        """Return the camera matrix (3, 3) and the distortion k1, k2, p1, p2 (4,), as OpenCV's."""
        (width, height), (right, down) = self.size, self.off_centre_px
        matrix = np.diag([self.focal_px, self.focal_px, 1.0])
        matrix[:2, 2] = width / 2.0 + right, height / 2.0 + down
        return matrix, np.array([*self.distortion, 0.0, 0.0])


class SimulatedCamera:
    """Takes pictures of a board on the tip of a simulated arm with compliant links.

    Without a stage the board is in front of a grey wall, and pictures are grey.

    Args:
        world: The arm.
        board: The board; if the arm's surroundings have none, it is not visible.
        view: The places of camera and board; the board faces the camera in the start pose.
        seed: The seed of the noise.

    Attributes:
        hint: Reason why the pictures show only the board; empty if they show more.

    Raises:
        SimulatorError: The servos have no arm.
    """

    def __init__(
        self, world: World, board: CharucoBoard, view: SimulatedView | None = None, seed: int = 0
    ) -> None:
        if world.tip is None:
            raise SimulatorError("these servos have no arm with a tip")
        self._world, self._tip = world, world.tip
        self._view = view = view or SimulatedView()
        home_m = self._tip.pose(world.home)[:3, 3]
        self.T_base_camera = look_at(home_m + view.from_tip_m, home_m)
        T_base_tip = self._tip.pose(world.placed)
        T_base_board = self.T_base_camera.copy()
        c, s = math.cos(view.tilt_rad), math.sin(view.tilt_rad)
        T_base_board[:3, :3] @= np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
        T_base_board[:3, 3] = T_base_tip[:3, 3] - view.aside_m * self.T_base_camera[:3, 2]
        self.T_tip_board = np.linalg.inv(T_base_tip) @ T_base_board
        self._chance = np.random.default_rng(seed)
        columns, rows = board.getChessboardSize()
        self._half_m = board.getSquareLength() * np.array([columns, rows]) / 2.0
        self._per_m = PIXELS_PER_SQUARE / board.getSquareLength()
        size = (columns * PIXELS_PER_SQUARE, rows * PIXELS_PER_SQUARE)
        self._board = board.generateImage(size).astype(np.float32)
        self._rays = _pixel_rays(view)
        around = world.surroundings
        self._has_board = around is None or around.has_board
        self._stage: Stage | None = None
        self._on_stage: NDArray[np.float32] | None = None
        self.hint = ""

    def set_stage(self) -> None:
        """Also draw the arm, its table and cubes, if MuJoCo can draw; otherwise set ``hint``."""
        around = self._world.surroundings
        if around is None:
            return
        try:
            from servosim.stage import MountedBoard, Stage, StageCamera  # noqa: PLC0415 - an extra
        except ImportError:
            self.hint = "The picture shows only the board. Everything else needs the extra physics."
            return
        flat = self._rays[..., :2] / self._rays[..., 2:]
        focal_px = self._view.focal_px
        half_px = np.ceil(focal_px * np.abs(flat).max(axis=(0, 1))) + 1.0
        width, height = (2 * half_px).astype(int).tolist()
        camera = StageCamera(self.T_base_camera, focal_px, (width, height))
        tip_m = np.linalg.inv(self.T_tip_board)[:3, 3].astype(np.float64)
        board = MountedBoard(self._half_m, tip_m) if self._has_board else None
        try:
            self._stage = Stage(around, camera, board)
        except SimulatorError as error:
            self.hint = f"The picture shows only the board: {error}."
        self._on_stage = (focal_px * flat + half_px - 0.5).astype(np.float32)

    def T_camera_board(self) -> Matrix:  # noqa: N802 - the name is the mathematics
        """Return the present pose of the board."""
        return np.linalg.inv(self.T_base_camera) @ self._tip_pose() @ self.T_tip_board

    def pixel(self, point_m: Matrix) -> Matrix:
        """Return the pixel (2,) of a point (3,), metres, base frame."""
        there = np.linalg.inv(self.T_base_camera).astype(np.float64)
        return _projected((there[:3, :3] @ point_m + there[:3, 3])[None], self._view)[0]

    def _tip_pose(self) -> Matrix:
        return self._tip.pose([joint.position for joint in self._world.joints])

    def take(self) -> NDArray[np.uint8]:
        """Take a picture (h, w), or (h, w, 3) with a stage, blue first."""
        import cv2  # noqa: PLC0415 - an extra

        picture, ahead_m = self._background()
        if self._has_board:
            self._draw_board(picture, ahead_m)
        small = cv2.resize(picture, self._view.size, interpolation=cv2.INTER_AREA)
        noisy = small + self._chance.normal(0.0, self._view.noise, small.shape)
        return np.clip(noisy, 0.0, 255.0).astype(np.uint8)

    def _background(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the picture without the board and the depth of each pixel [m].

        Both have four times the pixel count of the picture.
        """
        import cv2  # noqa: PLC0415 - an extra

        if self._stage is None or self._on_stage is None:
            shape = self._rays.shape[:2]
            return np.full(shape, BACKGROUND, np.float32), np.full(shape, np.inf, np.float32)
        joints, tip = self._world.joints, self._tip
        links = tip.link_positions([joint.position for joint in joints])
        positions = dict(zip((joint.name for joint in joints), links, strict=True))
        poses = [*self._world.cube_poses()]
        if self._has_board:
            poses.append(self._tip_pose() @ self.T_tip_board)
        colours, ahead_m = self._stage.draw(positions, poses)
        u, v = self._on_stage[..., 0], self._on_stage[..., 1]
        picture = cv2.remap(colours.astype(np.float32), u, v, cv2.INTER_LINEAR)
        far = cv2.remap(ahead_m.astype(np.float32), u, v, cv2.INTER_NEAREST)
        return picture, far

    def _draw_board(self, picture: NDArray[np.float32], ahead_m: NDArray[np.float32]) -> None:
        """Draw the board where nothing hides it, by intersecting each ray with its plane."""
        import cv2  # noqa: PLC0415 - an extra

        T = self.T_camera_board()
        if T[:3, 3] @ T[:3, 2] <= 0.0:
            return  # the camera sees the back of the board
        part = self._part_with_board(T)
        rays = self._rays[part]
        along = rays @ T[:3, 2]
        depth = np.divide(
            T[:3, 3] @ T[:3, 2], along, out=np.full(along.shape, -1.0), where=abs(along) > 1e-6
        )
        on_board = (rays * depth[..., None] - T[:3, 3]) @ T[:3, :2]
        seen = (np.abs(on_board) < self._half_m).all(axis=2)
        seen &= (depth > 0.0) & (depth < ahead_m[part] + IN_FRONT_M)
        if not seen.any():
            return
        at = ((on_board + self._half_m) * self._per_m - 0.5).astype(np.float32)
        drawn = cv2.remap(
            self._board, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        picture[part][seen] = drawn[seen] if picture.ndim == 2 else drawn[seen][:, None]

    def _part_with_board(self, T: Matrix) -> tuple[slice, slice]:
        """Return rows and columns of the rays that may meet the board."""
        x, y = self._half_m
        outline = np.array([[a, b, 0.0] for a in (-x, 0.0, x) for b in (-y, 0.0, y)])
        points = outline @ T[:3, :3].T + T[:3, 3]
        if points[:, 2].min() <= 0.0:
            return slice(None), slice(None)
        seen = _projected(points, self._view)
        margin = MARGIN_PX + MARGIN_SHARE * np.ptp(seen, axis=0)  # a lens bends straight edges
        low = np.maximum(2.0 * (seen.min(axis=0) - margin), 0.0).astype(int).tolist()
        high = np.maximum(2.0 * (seen.max(axis=0) + margin), 0.0).astype(int).tolist()
        return slice(low[1], high[1]), slice(low[0], high[0])


@lru_cache(maxsize=2)  # computing it takes 0.3 s
def _pixel_rays(view: SimulatedView) -> Matrix:
    """Return the viewing direction (2h, 2w, 3) of each quarter of a pixel; read only."""
    import cv2  # noqa: PLC0415 - an extra

    width, height = view.size
    x, y = np.meshgrid(np.arange(2 * width) / 2.0 - 0.25, np.arange(2 * height) / 2.0 - 0.25)
    pixels = np.stack([x.ravel(), y.ravel()], axis=1)
    flat = cv2.undistortPoints(pixels[:, None], *view.lens())
    rays = np.concatenate([flat[:, 0], np.ones((len(flat), 1))], axis=1)
    rays = rays.reshape(2 * height, 2 * width, 3)
    rays.setflags(write=False)
    return rays


def _projected(points_m: Matrix, view: SimulatedView) -> Matrix:
    """Return the pixels (n, 2) of points (n, 3) ahead of a camera, in its frame."""
    import cv2  # noqa: PLC0415 - an extra

    project = cast("Any", cv2).projectPoints  # missing in its stubs
    seen: Matrix = project(points_m, np.zeros(3), np.zeros(3), *view.lens())[0]
    return seen.reshape(-1, 2)
