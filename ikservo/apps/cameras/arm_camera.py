"""The calibrated camera in front of an arm, which finds points on the table and on things."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ikservo.apps.cameras.blocks import find_block_at, find_blocks
from ikservo.apps.cameras.board import Board
from ikservo.apps.cameras.board_detection import Intrinsics, Picture, PictureSource
from ikservo.apps.cameras.camera_file import SIMULATED, CameraFile, camera_names, load_camera
from ikservo.apps.cameras.camera_model import CameraModel
from ikservo.apps.cameras.camera_sources import open_source
from ikservo.arguments import parse_number
from ikservo.arm.arm_protocol import OpenArm
from ikservo.arm.opening import require_own_port
from ikservo.arm.scene import Scene
from ikservo.calibration.records import CalibratedCamera
from ikservo.cli.camera_options import DEFAULT_BOARD
from ikservo.errors import CalibrationError, InputError, UnknownNameError
from ikservo.files.public_source import public_source
from ikservo.kinematics.arrays import FrozenArrays, Vector, finite_vector
from ikservo.kinematics.rays import Ray
from ikservo.kinematics.se3 import exp_so3, make_pose
from ikservo.model import Model
from ikservo.model.arm_model import Obstacle
from ikservo.model.scene_file import KeepOutShape
from ikservo.planning.calibrated_arm import ZeroSource
from ikservo.planning.context import ArmContext


@dataclass(frozen=True, slots=True, eq=False)
class SeenPoint(FrozenArrays):
    """The first point that a pixel sees.

    Attributes:
        point_m: The point (3,), metres, base frame.
        thing: The name of the thing in the scene; None for the table.
    """

    point_m: Vector
    thing: str | None = None


class ArmCamera:
    """The camera with which an arm was calibrated; it is fixed in front of the arm.

    A pixel (u, v) is counted as in OpenCV: u to the right, v down, (0, 0) at the centre of the
    first pixel, in the picture that the camera delivers; lens distortion is taken into account.
    Points are in the arm's base frame, metres. Each call reads the last result of `ikservo camera
    check`.

    Args:
        context: The arm.
        scene: The scene around the arm.
        name: The camera name; see ``known_camera``.
    """

    def __init__(self, context: ArmContext, scene: Scene, name: str = "") -> None:
        self._context, self._scene, self._name = context, scene, name
        self._source: PictureSource | None = None

    def __repr__(self) -> str:
        """Show the arm's name."""
        return f"ArmCamera(of {self._context.model.name!r})"

    def named(self, name: str, source: str | None = None) -> ArmCamera:
        """Return the camera with a given name or source, if the arm was calibrated with several.

        Raises:
            UnknownNameError: The arm was not calibrated with a camera of that name.
            CalibrationError: The arm was not calibrated with the camera of that source.
            FileFormatError: A file about the camera is damaged.
        """
        camera, _, name = known_camera(self._context, name, source)
        if source is not None and public_source(camera.source) != public_source(source):
            raise CalibrationError(
                f"{self._context.model.name} was calibrated with camera "
                f"{public_source(camera.source)}, not {public_source(source)}.",
                "Use that camera, or calibrate this one under another name.",
            )
        return ArmCamera(self._context, self._scene, name)

    def model(self) -> CameraModel:
        """Return the lens and the pose of the camera.

        Raises:
            CalibrationError: The arm has no calibrated camera, or the camera has moved since.
            FileFormatError: A file about the camera is damaged.
        """
        camera, known = known_camera(self._context, self._name)[:2]
        if known.check is not None and known.check.has_moved:
            raise moved_error(known.check.moved_mm, known.check.turned_deg)
        return camera_model(camera)

    def picture(self, source: str | None = None) -> Picture:
        """Take a picture; the first call opens the camera, which stays open.

        Args:
            source: The address with the password, which the calibration does not store; None for
                the address in the calibration.

        Returns:
            The picture: grey (h, w) or colour (h, w, 3), blue first, as in OpenCV.

        Raises:
            CalibrationError: The arm has no calibrated camera, the camera has moved since its
                calibration or delivers no picture, or the picture has a different size.
            InputError: OpenCV is not installed, or there is no such camera.
        """
        size, camera = self.model().lens.size, known_camera(self._context, self._name)[0]
        if self._source is None:
            board = Board.named(camera.board.name if camera.board else DEFAULT_BOARD)
            source = source or camera.source
            self._source = open_source(source, self._context.port.transport, board)
        picture = self._source.take()
        if picture.shape[1::-1] != size:
            raise size_error(picture.shape[1::-1], size)
        return picture

    def point_on_table(self, u: float, v: float, height_m: float = 0.0) -> Vector:
        """Return the point on the table, or on a level plane above it, that a pixel sees.

        Args:
            u: Pixels to the right.
            v: Pixels down.
            height_m: The height of the plane above the table, metres; the table is at the height
                that the arm file gives, or else at z = 0.

        Returns:
            The point (3,), metres, base frame.

        Raises:
            BadValueError: The pixel is not in the picture, or a number is not finite.
            InputError: The line of sight does not meet the table.
            CalibrationError: The arm has no calibrated camera, or the camera has moved since.
        """
        (height_m,) = finite_vector([parse_number("The height", height_m)], 1, "The height")
        z_m = table_m(self._context.model) + float(height_m)
        return first_seen(self._ray(u, v), (), z_m).point_m

    def point_seen(self, u: float, v: float) -> SeenPoint:
        """Return the first point on the table or on a thing that a pixel (u, v) sees.

        Raises:
            BadValueError: The pixel is not in the picture.
            InputError: The line of sight meets neither the table nor a thing.
            CalibrationError: The arm has no calibrated camera, or the camera has moved since.
        """
        return first_seen(self._ray(u, v), self._scene.things, table_m(self._context.model))

    def blocks(self) -> list[KeepOutShape]:
        """Return at most eight coloured blocks that stand on the table, for use with ``pick``.

        Raises:
            CalibrationError: See ``picture``.
        """
        return find_blocks(self.model(), self.picture(), table_m(self._context.model))

    def block_at(self, u: float, v: float) -> KeepOutShape:
        """Return the coloured block that a pixel (u, v) shows.

        Raises:
            InputError: The pixel shows no block.
            CalibrationError: See ``picture``.
        """
        z_m = table_m(self._context.model)
        return find_block_at(self.model(), self.picture(), z_m, u, v)

    def pixel(self, point_m: Vector) -> tuple[float, float]:
        """Return the pixel (u, v) of a point (3,), metres, base frame, even outside the picture.

        Raises:
            BadValueError: The point is not finite.
            InputError: The point is not in front of the camera.
            CalibrationError: The arm has no calibrated camera, or the camera has moved since.
        """
        px, depth_m = self.model().project(finite_vector(point_m, 3, "The point"))
        if float(depth_m) <= 0.0:
            raise InputError(
                "The point is behind the camera.", "Choose a point that the camera sees."
            )
        return float(px[0]), float(px[1])

    def _ray(self, u: float, v: float) -> Ray:
        u, v = parse_number("The pixel's u", u), parse_number("The pixel's v", v)
        return self.model().ray(u, v)


def camera_of(arm: OpenArm) -> ArmCamera:
    """Return the calibrated camera of an open arm, which finds points on the table from pixels.

    Raises:
        RefusedError: The arm is on another machine.
    """
    own = require_own_port(arm)
    return ArmCamera(own.context, own.scene)


def camera_key(context: ArmContext) -> str:
    """Return the adapter's serial number, which distinguishes arms of the same name."""
    return SIMULATED if context.zeros is ZeroSource.SIMULATED else context.serial_number


def known_camera(
    context: ArmContext, name: str = "", source: str | None = None
) -> tuple[CalibratedCamera, CameraFile, str]:
    """Return a camera of an arm, the stored facts about the camera, and its name.

    Args:
        context: The arm.
        name: The camera name; empty: the camera without a name, or the only camera.
        source: The preferred source if no name is given; None for no preference.

    Raises:
        CalibrationError: The arm has no calibrated camera.
        UnknownNameError: The arm has no camera of that name.
        InputError: The arm has several cameras, and a name is needed.
        FileFormatError: A file about the camera is damaged.
    """
    arm, key = context.model.name, camera_key(context)
    names = camera_names(arm, key)
    cameras = {each: found for each in names if (found := load_camera(arm, key, each))}
    if not cameras:
        raise CalibrationError(
            f"{arm} has no calibrated camera.",
            "Fix a printed board to its gripper and calibrate the camera: "
            f"ikservo calibrate {arm} --camera 0",
        )
    if name and name not in cameras:
        raise UnknownNameError("camera", name, filter(None, cameras))
    if not name and source is not None:
        asked = public_source(source)
        same = [each for each, found in cameras.items() if public_source(found[0].source) == asked]
        name = same[0] if len(same) == 1 else ""
    if name not in cameras:
        if len(cameras) > 1:
            raise InputError(f"{arm} has several cameras.", f"Choose one: {', '.join(cameras)}.")
        name = next(iter(cameras))
    return *cameras[name], name


def camera_model(camera: CalibratedCamera) -> CameraModel:
    """Return the lens and the pose that are stored for a camera."""
    fx, fy, cx, cy = camera.lens_px
    matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    lens = Intrinsics(matrix, np.array(camera.distortion), camera.size_px)
    R = exp_so3(np.radians(camera.turned_deg))
    return CameraModel(lens, make_pose(np.array(camera.at_mm) / 1000.0, R))


def table_m(model: Model) -> float:
    """Return the height of the table in the base frame, metres: from the arm file, or 0."""
    return 0.0 if model.floor_m is None else model.floor_m


def first_seen(ray: Ray, things: Iterable[Obstacle], z_m: float) -> SeenPoint:
    """Find the first point on a ray that lies on a thing or on the level plane at ``z_m``.

    Raises:
        InputError: The ray meets neither a thing nor the plane.
    """
    hits: list[tuple[float, str | None]] = [(ray.distance_to_level_m(z_m), None)]
    hits += [(ray.distance_to_thing_m(thing.row), thing.name) for thing in things]
    distance_m, name = min(hits, key=lambda hit: hit[0])
    if not np.isfinite(distance_m):
        hint = "Choose a pixel that shows the table."
        raise InputError("The pixel's line of sight does not meet the table.", hint)
    return SeenPoint(ray.at(distance_m), name)


def size_error(found: tuple[int, ...], calibrated: tuple[int, int]) -> CalibrationError:
    """Return the error for pictures whose size differs from that in the calibration."""
    seen, known = (" x ".join(map(str, size)) for size in (found, calibrated))
    text = f"The pictures have {seen} pixels; the camera was calibrated with {known}."
    return CalibrationError(text, "Use the camera that was calibrated.")


def moved_error(moved_mm: float, turned_deg: float) -> CalibrationError:
    """Return the error for a camera that has moved since its calibration."""
    return CalibrationError(
        f"The camera has moved by {moved_mm:.0f} mm and turned by {turned_deg:.1f}° since it was "
        "calibrated.",
        "Put it back and check again, or calibrate again.",
    )
