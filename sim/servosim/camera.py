"""A camera before a simulated arm: pictures of a board on its tip, drawn with OpenCV."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from servosim.errors import SimulatorError
from servosim.urdf import Matrix
from servosim.world import World

if TYPE_CHECKING:
    from cv2.aruco import CharucoBoard

__all__ = ["SimulatedCamera", "SimulatedView"]

PIXELS_PER_SQUARE = 40  # of the board's picture
BACKGROUND = 150.0  # grey of what is behind it


def look_at(eye_m: Matrix, point_m: Matrix) -> Matrix:
    """Return T_base_camera (4, 4) at an eye, z towards a point, x to the right, y down."""
    z = (point_m - eye_m) / np.linalg.norm(point_m - eye_m)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3] = np.column_stack([x, np.cross(z, x), z, eye_m])
    return T


@dataclass(frozen=True)
class SimulatedView:
    """A camera, and how a board is fixed to the tip.

    Attributes:
        from_tip_m: Where the camera stands, from where the tip is at first (3,), base frame.
        aside_m: How far the board is from the tip, towards the camera.
        tilt_rad: By how much it is tilted away from the camera at first.
        focal_px: Of the lens.
        off_centre_px: Where its axis meets the picture, from the picture's centre, right and down.
        distortion: k1 and k2.
        size: Width and height of the pictures.
        noise: Standard deviation of each pixel, of 255.
    """

    from_tip_m: tuple[float, float, float] = (0.36, 0.14, 0.2)
    aside_m: float = 0.03
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
    """Takes pictures of a board on the tip of a simulated arm, whose links give way.

    Args:
        world: The arm.
        board: The board.
        view: Where camera and board are; the board faces the camera as the arm was placed.
        seed: Of the noise.

    Raises:
        SimulatorError: There is no arm.
    """

    def __init__(
        self, world: World, board: CharucoBoard, view: SimulatedView | None = None, seed: int = 0
    ) -> None:
        if world.tip is None:
            raise SimulatorError("these servos have no arm with a tip")
        self._world, self._tip = world, world.tip
        self._view = view = view or SimulatedView()
        T_base_tip = self._tip.pose(world.placed)
        self.T_base_camera = look_at(T_base_tip[:3, 3] + view.from_tip_m, T_base_tip[:3, 3])
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
        self._rays = self._pixel_rays()

    def T_camera_board(self) -> Matrix:  # noqa: N802 - the name is the mathematics
        """Return where the board is at present."""
        return np.linalg.inv(self.T_base_camera) @ self._tip_pose() @ self.T_tip_board

    def pixel(self, point_m: Matrix) -> Matrix:
        """Return the pixel (2,) of a point (3,), metres, base frame."""
        import cv2  # noqa: PLC0415 - an extra

        ahead = np.linalg.inv(self.T_base_camera) @ np.append(point_m, 1.0)
        lens, distortion = self._view.lens()
        project = cast("Any", cv2).projectPoints  # missing in its stubs
        return np.ravel(project(ahead[None, :3], np.zeros(3), np.zeros(3), lens, distortion)[0])

    def _tip_pose(self) -> Matrix:
        return self._tip.pose([joint.position for joint in self._world.joints])

    def take(self) -> NDArray[np.uint8]:
        """Take a picture (h, w): each pixel's ray meets the board's plane."""
        import cv2  # noqa: PLC0415 - an extra

        T, view = self.T_camera_board(), self._view
        along = self._rays @ T[:3, 2]
        depth = np.divide(
            T[:3, 3] @ T[:3, 2], along, out=np.full(along.shape, -1.0), where=abs(along) > 1e-6
        )
        on_board = (self._rays * depth[..., None] - T[:3, 3]) @ T[:3, :2]
        at = ((on_board + self._half_m) * self._per_m - 0.5).astype(np.float32)
        at[(depth <= 0.0) | (T[:3, 3] @ T[:3, 2] <= 0.0)] = -1e6  # behind it, or from its back
        picture = cv2.remap(
            self._board, at[..., 0], at[..., 1], cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT, borderValue=BACKGROUND,
        )  # fmt: skip
        small = cv2.resize(picture, view.size, interpolation=cv2.INTER_AREA)
        noisy = small + self._chance.normal(0.0, view.noise, small.shape)
        return np.clip(noisy, 0.0, 255.0).astype(np.uint8)

    def _pixel_rays(self) -> Matrix:
        """Return the direction (2h, 2w, 3) of what each quarter of a pixel sees."""
        import cv2  # noqa: PLC0415 - an extra

        view = self._view
        width, height = view.size
        x, y = np.meshgrid(np.arange(2 * width) / 2.0 - 0.25, np.arange(2 * height) / 2.0 - 0.25)
        pixels = np.stack([x.ravel(), y.ravel()], axis=1)
        flat = cv2.undistortPoints(pixels[:, None], *view.lens())
        ahead = np.concatenate([flat[:, 0], np.ones((len(flat), 1))], axis=1)
        return ahead.reshape(2 * height, 2 * width, 3)
