"""The 3D scene of the page: links, shapes and boxes once, then positions of the joints and marks.

The page builds a scene graph from the description and moves its nodes by the joint positions, so
that no outlines are sent::

    graph = SceneGraph(model, chain, extent)
    graph.description             # sent once
    graph.fields(state)           # sent with every scene, where it differs from the last one

Lengths are metres, angles rad, poses T_parent_child (4, 4) row by row, all in the base frame or in
the frame of the link. Meshes travel as the corners of their triangles, little-endian float32 in
base64; a mesh that is missing or very fine is drawn as the capsules around it.
"""

from __future__ import annotations

import base64
import contextlib
from collections.abc import Iterator, Mapping

import numpy as np

from ikservo.errors import FileFormatError, InputError
from ikservo.kinematics import Chain, ChainJoint, JointType
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.capsules import Capsule
from ikservo.kinematics.se3 import make_pose, rotation_rpy
from ikservo.model import Model
from ikservo.model.collision_model import bounding_capsules
from ikservo.model.meshes import mesh_triangles
from ikservo.model.tool import tool_frame
from ikservo.model.urdf_types import Box, Cylinder, Mesh, Shape, Sphere, Surface, Triple, UrdfLink
from ikservo.view.camera import Camera
from ikservo.view.draw_items import other_joint_position
from ikservo.view.reachable_region import ReachableRegion
from ikservo.view.scene import SceneState
from ikservo.view.tool_handles import ToolHandles
from ikservo.view.viewpoints import ArmExtent

__all__ = ["SceneGraph"]

Fields = dict[str, object]

_MAX_TRIANGLES = 15_000  # of one mesh: 0.7 MB in base64
_DIGITS = 7  # of joint positions: at a metre's distance 0.1 µm
_REGION_DIGITS = 4
_AXIS_DIGITS = 4
_UNUSABLE = (FileFormatError, InputError)


class SceneGraph:
    """What the page needs to draw an arm in 3D.

    Args:
        model: The arm.
        chain: Its joints inside its own, calibrated limits.
        extent: The space it can occupy.

    Attributes:
        description: Everything that does not move.
    """

    def __init__(self, model: Model, chain: Chain, extent: ArmExtent) -> None:
        self._chain = chain
        self._handles = ToolHandles(chain, tool_frame(model).approach_axis)
        steps = {link: chain.joints_to(link)[-1] for link in chain.frames if link != chain.base}
        self._moving = [step for step in steps.values() if step.joint.kind is not JointType.FIXED]
        self.description: Fields = {
            "kind": "graph",
            "links": [
                {
                    "name": link,
                    **_joint_fields(steps.get(link)),
                    "shapes": _link_shapes(model, link),
                }
                for link in chain.frames
            ],
            "tip": chain.tip,
            "boxes": [
                {"name": box.name, "low": box.low_m, "high": box.high_m} for box in model.keep_out
            ],
            "floor": model.floor_m,
            "centre": extent.pivot_m.tolist(),
            "handles": self._handles.description,
            "size": float(np.linalg.norm(extent.own_m[1] - extent.own_m[0])),
        }

    def fields(self, state: SceneState, *, handles: bool = False) -> Fields:
        """Return the fields of a scene: joint positions of arm and goal, camera, marks.

        Args:
            state: What is shown.
            handles: Whether the tool has handles: their axes (3, 3) in the base frame.
        """
        others = state.other_joints if state.goal_other_joints is None else state.goal_other_joints
        return {
            "camera": _camera_fields(state.camera),
            "measured": self._positions(state.measured, state.other_joints),
            "goal": self._positions(state.goal, others)
            if state.goal is not None and state.shows_goal
            else None,
            "handles": self._handle_axes(state) if handles else None,
            "behind": state.behind,
            "refused_pair": state.refused_pair,
            **_region_fields(state.region),
        }

    def _handle_axes(self, state: SceneState) -> list[float]:
        axes = self._handles.axes(state.measured if state.goal is None else state.goal)
        rounded: list[float] = np.round(axes, _AXIS_DIGITS).ravel().tolist()
        return rounded

    def _positions(self, q: Vector, others: Mapping[str, float]) -> list[float]:
        """Return the position of each joint that is not fixed, rad or m, in the order of links."""
        return [round(_position(step, q, others), _DIGITS) for step in self._moving]


def _position(step: ChainJoint, q: Vector, others: Mapping[str, float]) -> float:
    other = None if step.scale else other_joint_position(step.joint, others)
    return float(step.value(q)) if other is None else other


def _joint_fields(step: ChainJoint | None) -> Fields:
    """Return how a link is fixed to its parent; of the base, that it has none."""
    if step is None:
        return {"parent": None, "origin": _pose(np.eye(4)), "joint": "fixed"}
    joint = step.joint
    return {
        "parent": joint.parent,
        "origin": _pose(joint.origin),
        "joint": joint.kind.value,
        "axis": joint.axis.tolist(),
    }


def _link_shapes(model: Model, name: str) -> list[Fields]:
    """Return the visual shapes of a link, or else its collision shapes, as far as usable."""
    link = next((each for each in model.urdf.links if each.name == name), None)
    if link is None:  # the tip of a tool
        return []
    with contextlib.suppress(*_UNUSABLE):
        return list(_visual_fields(link)) or _collision_fields(link)
    with contextlib.suppress(*_UNUSABLE):
        return _collision_fields(link)
    return []


def _visual_fields(link: UrdfLink) -> Iterator[Fields]:
    colours = link.colours or (None,) * len(link.visuals)
    for shape, colour in zip(link.visuals, colours, strict=True):
        yield from _shape_fields(link.name, shape, colour)


def _collision_fields(link: UrdfLink) -> list[Fields]:
    return [each for shape in link.collisions for each in _shape_fields(link.name, shape, None)]


def _shape_fields(link: str, shape: Shape, colour: Triple | None) -> list[Fields]:
    """Return a shape as one or more primitives of the page.

    Raises:
        FileFormatError: A mesh cannot be used.
        InputError: A mesh needs the extra ``mesh``, which is not installed.
    """
    T = make_pose(shape.xyz_m, rotation_rpy(*shape.rpy_rad))
    shared: Fields = {"pose": _pose(T), "colour": colour}
    match shape:
        case Box():
            return [{"shape": "box", "size": shape.size_m, **shared}]
        case Cylinder():
            return [{"shape": "cylinder", "size": [shape.radius_m, shape.length_m], **shared}]
        case Sphere():
            return [{"shape": "sphere", "size": [shape.radius_m], **shared}]
        case Mesh() | Surface():
            return _mesh_fields(link, shape, shared)


def _mesh_fields(link: str, mesh: Mesh | Surface, shared: Fields) -> list[Fields]:
    triangles = mesh.triangles_m if isinstance(mesh, Surface) else mesh_triangles(link, mesh)
    if len(triangles) > _MAX_TRIANGLES:
        return [_capsule_fields(each, shared) for each in bounding_capsules(link, mesh)]
    corners = base64.b64encode(np.ascontiguousarray(triangles, dtype="<f4").tobytes())
    return [{"shape": "mesh", "corners": corners.decode(), **shared}]


def _capsule_fields(capsule: Capsule, shared: Fields) -> Fields:
    """Return a capsule in link coordinates, along the y axis of its own frame."""
    along = capsule.end_m - capsule.start_m
    length_m = float(np.linalg.norm(along))
    y = along / length_m if length_m else np.array([0.0, 1.0, 0.0])
    x = np.cross(y, np.eye(3)[int(np.argmin(np.abs(y)))])
    x = x / np.linalg.norm(x)
    T = make_pose(0.5 * (capsule.start_m + capsule.end_m), np.column_stack([x, y, np.cross(x, y)]))
    size = [capsule.radius_m, length_m]
    return {**shared, "shape": "capsule", "size": size, "pose": _pose(T)}


def _camera_fields(camera: Camera) -> Fields:
    T_world_camera = make_pose(camera.eye_m, camera.R_world_view)
    return {"pose": _pose(T_world_camera), "focal_px": camera.scale_px}


def _region_fields(region: ReachableRegion | None) -> Fields:
    if region is None:
        return {"region": None, "region_pose": None}
    rings = [np.round(ring, _REGION_DIGITS).tolist() for ring in region.rings]
    return {"region": rings, "region_pose": _pose(region.T_world_plane)}


def _pose(T: Matrix) -> list[float]:
    return T.ravel().tolist()
