"""Pictures of an arm, its table, a board and cubes, drawn by MuJoCo (extra `physics`)."""

from __future__ import annotations

import math
import os
import sys
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from servosim.errors import ArmFileError, SimulatorError
from servosim.surroundings import COLOURS, Surroundings
from servosim.urdf import Matrix, base_pose, read_joints

_TABLE_HALF_M, _SQUARE_M = 0.6, 0.05
_TABLE_LIGHT, _TABLE_DARK = (0.80, 0.77, 0.72), (0.75, 0.72, 0.67)
_WALL_ABOVE, _WALL_BELOW = (0.80, 0.84, 0.88), (0.62, 0.65, 0.68)
_PAPER, _PAPER_HALF_M, _PAPER_MARGIN_M = (0.93, 0.93, 0.92, 1.0), 0.001, 0.004
_HOLDER, _HOLDER_RADIUS_M = (0.35, 0.37, 0.40, 1.0), 0.004
_LAMP_AT, _LAMP_BRIGHTNESS, _SHADE_BRIGHTNESS = (0.3, 0.5, 1.5), 0.45, 0.35
_OPENCV_TO_MUJOCO = np.diag([1.0, -1.0, -1.0])  # MuJoCo's cameras look along -z, y upwards
_COLLISION, _VISUAL = 0, 1  # MuJoCo's groups of the shapes in a URDF
_NEAR_M, _FAR_M = 0.02, 20.0
_MOST_SHAPES = 1000


@dataclass(frozen=True, slots=True)
class StageCamera:
    """A camera without distortion, whose axis passes through the middle of the picture.

    Attributes:
        T_base_camera: The camera's pose (4, 4): x to the right, y down, z ahead.
        focal_px: The focal length of the lens.
        size: Width and height of the pictures.
    """

    T_base_camera: Matrix
    focal_px: float
    size: tuple[int, int]


@dataclass(frozen=True, slots=True)
class MountedBoard:
    """A board on the arm's tip.

    Attributes:
        half_m: Half the side lengths (2,).
        tip_m: The tip (3,) in the board's frame, where the board holder begins.
    """

    half_m: Matrix
    tip_m: Matrix


class Stage:
    """The scene of a camera: an arm on a table, a board on its tip, cubes.

    Several threads may draw; each has its own OpenGL context.

    Args:
        around: The arm and the cubes. The visual shapes of its URDF are drawn, or its collision
            shapes if a link has no visual ones.
        camera: The camera.
        board: The board; None if there is no board.

    Raises:
        ArmFileError: MuJoCo cannot use the URDF.
        SimulatorError: There is no OpenGL to draw with.
    """

    def __init__(
        self, around: Surroundings, camera: StageCamera, board: MountedBoard | None
    ) -> None:
        self._into_urdf: Matrix = np.linalg.inv(base_pose(around.arm.base)).astype(np.float64)
        self._joints = read_joints(around.arm.urdf)
        self._size, self._drawings = camera.size, threading.local()
        self._model = self._compile(around, camera, board)
        self._data = mujoco.MjData(self._model)
        self._names = [cube.name for cube in around.cubes] + ["board"] * (board is not None)
        _open_context(1, 1).free()  # raises without OpenGL

    def draw(
        self, positions: Mapping[str, float], poses: Sequence[Matrix]
    ) -> tuple[NDArray[np.uint8], Matrix]:
        """Draw a picture.

        Args:
            positions: The positions of the arm's joints, by name [rad or m].
            poses: The poses of the cubes, then of the board if there is one (4, 4), base frame. The
                board's pattern is on its -z side.

        Returns:
            The picture (h, w, 3), blue first, and the distance of its contents ahead of the camera
            (h, w) [m].
        """
        model, data = self._model, self._data
        for joint in self._joints:
            address = model.jnt_qposadr[model.joint(joint.name).id]
            data.qpos[address] = joint.multiplier * positions.get(joint.mimic, 0.0) + joint.offset
        for name, pose in zip(self._names, poses, strict=True):
            T, number = self._into_urdf @ pose, model.body(name).mocapid[0]
            data.mocap_pos[number], data.mocap_quat[number] = T[:3, 3], _quaternion(T[:3, :3])
        for update in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_camlight):
            update(model, data)
        if not hasattr(self._drawings, "own"):
            self._drawings.own = _Drawing(model, self._size)
        colours, depth = self._drawings.own.draw(data)
        # MuJoCo gives the depth as stored by OpenGL: 1 at the near plane, 0 at the far one.
        ahead_m = 1.0 / (1.0 / _FAR_M + depth * (1.0 / _NEAR_M - 1.0 / _FAR_M))
        return np.ascontiguousarray(colours[::-1, :, ::-1]), ahead_m[::-1].astype(np.float64)

    def _compile(
        self, around: Surroundings, camera: StageCamera, board: MountedBoard | None
    ) -> mujoco.MjModel:
        """Return the model to draw; nothing in it moves by itself."""
        path = around.arm.urdf
        try:
            spec = mujoco.MjSpec.from_file(str(path))
            spec.compiler.discardvisual, spec.compiler.balanceinertia = False, True
            spec.visual.global_.offwidth, spec.visual.global_.offheight = camera.size
            spec.stat.extent = 1.0
            spec.visual.map.znear, spec.visual.map.zfar = _NEAR_M, _FAR_M
            _hide_collision_shapes(spec)
            self._add_room(spec, around.arm.floor_m)
            self._add_camera(spec, camera)
            for cube in around.cubes:
                body = spec.worldbody.add_body(name=cube.name, mocap=True)
                _add_box(body, (cube.half_m,) * 3, (*COLOURS[cube.colour], 1.0))
            if board is not None:
                _add_board(spec, board)
            return spec.compile()
        except (ValueError, OSError) as error:
            raise ArmFileError(path, "", f"MuJoCo cannot draw it ({error})") from error

    def _add_room(self, spec: mujoco.MjSpec, floor_m: float) -> None:
        """Add light, a wall, and the table with squares that begin at the base's origin."""
        spec.add_texture(
            name="table", type=mujoco.mjtTexture.mjTEXTURE_2D, width=256, height=256,
            builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER, rgb1=_TABLE_LIGHT, rgb2=_TABLE_DARK,
        )  # fmt: skip
        spec.add_texture(
            name="wall", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, width=64, height=384,
            builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT, rgb1=_WALL_ABOVE, rgb2=_WALL_BELOW,
        )  # fmt: skip
        table = spec.add_material(
            name="table", texrepeat=(1.0 / _SQUARE_M,) * 2, texuniform=True, specular=0.1
        )
        table.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "table"
        T = self._into_urdf.copy()
        T[:3, 3] += floor_m * T[:3, 2]
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_PLANE, size=(_TABLE_HALF_M, _TABLE_HALF_M, 0.01),
            material="table", group=_VISUAL, pos=T[:3, 3], quat=_quaternion(T[:3, :3]),
        )  # fmt: skip
        lamp = (self._into_urdf @ [*_LAMP_AT, 1.0])[:3]
        spec.worldbody.add_light(
            pos=lamp, dir=-lamp / np.linalg.norm(lamp), diffuse=(_LAMP_BRIGHTNESS,) * 3,
            specular=(0.2,) * 3, castshadow=True,
        )  # fmt: skip
        spec.visual.headlight.ambient = spec.visual.headlight.diffuse = (_SHADE_BRIGHTNESS,) * 3
        spec.visual.headlight.specular = (0.0,) * 3

    def _add_camera(self, spec: mujoco.MjSpec, camera: StageCamera) -> None:
        T = self._into_urdf @ camera.T_base_camera
        spec.worldbody.add_camera(
            name="eye", pos=T[:3, 3], quat=_quaternion(T[:3, :3] @ _OPENCV_TO_MUJOCO),
            fovy=math.degrees(2.0 * math.atan(0.5 * camera.size[1] / camera.focal_px)),
        )  # fmt: skip


class _Drawing:
    """Drawing objects of one thread."""

    def __init__(self, model: mujoco.MjModel, size: tuple[int, int]) -> None:
        self._opengl = _open_context(*size)
        self._opengl.make_current()
        scale, buffer = mujoco.mjtFontScale.mjFONTSCALE_100, mujoco.mjtFramebuffer.mjFB_OFFSCREEN
        self._context = mujoco.MjrContext(model, scale.value)
        mujoco.mjr_setBuffer(buffer.value, self._context)
        self._context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR
        self._model, self._scene = model, mujoco.MjvScene(model, _MOST_SHAPES)
        self._options, self._perturbation = mujoco.MjvOption(), mujoco.MjvPerturb()
        self._camera = mujoco.MjvCamera()
        self._camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
        self._camera.fixedcamid = model.camera("eye").id
        self._area = mujoco.MjrRect(0, 0, *size)

    def draw(self, data: mujoco.MjData) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Return colours (h, w, 3) and depths (h, w), the lowest row first."""
        mujoco.mjv_updateScene(
            self._model, data, self._options, self._perturbation, self._camera,
            mujoco.mjtCatBit.mjCAT_ALL.value, self._scene,
        )  # fmt: skip
        mujoco.mjr_render(self._area, self._scene, self._context)
        shape = (self._area.height, self._area.width)
        colours, depth = np.empty((*shape, 3), np.uint8), np.empty(shape, np.float32)
        mujoco.mjr_readPixels(colours, depth, self._area, self._context)
        return colours, depth


def _open_context(width: int, height: int) -> mujoco.GLContext:
    """Open an OpenGL context; on Linux without a window system, unless another one is chosen.

    Raises:
        SimulatorError: No context can be opened.
    """
    try:
        if sys.platform == "linux" and not os.environ.get("MUJOCO_GL"):
            from mujoco.egl import GLContext  # noqa: PLC0415 - only on Linux
        else:
            from mujoco import GLContext  # noqa: PLC0415 - on other systems
        return GLContext(width, height)
    except Exception as error:  # each library has its own errors
        raise SimulatorError(f"MuJoCo cannot draw here ({error})") from error


def _hide_collision_shapes(spec: mujoco.MjSpec) -> None:
    """Hide the collision shapes of links that have visual shapes."""
    if any(shape.group == _VISUAL for shape in spec.geoms):
        for shape in spec.geoms:
            if shape.group == _COLLISION:
                shape.rgba = (0.0,) * 4


def _add_board(spec: mujoco.MjSpec, board: MountedBoard) -> None:
    body = spec.worldbody.add_body(name="board", mocap=True)
    x_m, y_m = (board.half_m + _PAPER_MARGIN_M).tolist()
    _add_box(body, (x_m, y_m, _PAPER_HALF_M), _PAPER, (0.0, 0.0, _PAPER_HALF_M))
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=(_HOLDER_RADIUS_M, 0.0, 0.0), rgba=_HOLDER,
        fromto=(0.0, 0.0, 2.0 * _HOLDER_RADIUS_M, *board.tip_m.tolist()), group=_VISUAL,
    )  # fmt: skip


def _add_box(
    body: mujoco.MjsBody,
    half_m: tuple[float, ...],
    rgba: tuple[float, ...],
    at_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> None:
    box = mujoco.mjtGeom.mjGEOM_BOX
    body.add_geom(type=box, size=half_m, rgba=rgba, pos=at_m, group=_VISUAL)


def _quaternion(R: Matrix) -> Matrix:
    found = np.zeros(4)
    mujoco.mju_mat2Quat(found, np.ascontiguousarray(R).ravel())
    return found
