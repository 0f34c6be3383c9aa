"""The arm as the page draws it: a description once, then joint positions and marks.

The page draws the arm itself, in 2D from the capsules and in 3D from the shapes::

    graph = SceneGraph(model, chain, extent)
    graph.description             # sent once
    graph.shapes                  # sent once to a page that draws in 3D
    graph.fields(state)           # sent with every scene, if it differs from the last one

Lengths are metres, angles rad, poses T_parent_child (4, 4) row by row, all in the base frame or in
the frame of the link.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cached_property, lru_cache

import numpy as np

from ikservo.apps.page.dragging.goal_planning import PlannedPath
from ikservo.apps.page.dragging.tool_handles import ToolHandles
from ikservo.apps.page.drawing.scene_shapes import Fields, link_shapes, row_major
from ikservo.apps.page.drawing.view_picture import SceneState
from ikservo.apps.page.picking.joint_dials import JointDial, joint_dials
from ikservo.apps.page.picking.lens_camera import LensCamera
from ikservo.apps.page.picking.link_poses import other_joint_position
from ikservo.apps.page.picking.projection import NEAR_PLANE_M, Camera
from ikservo.apps.page.picking.viewpoints import ArmExtent
from ikservo.calibration.joint_limits import at_distance, near_distance
from ikservo.kinematics import Chain, ChainJoint, JointType
from ikservo.kinematics.arrays import Vector
from ikservo.kinematics.se3 import make_pose
from ikservo.model import Model
from ikservo.model.collision_capsules import capsules_of
from ikservo.model.tool import tool_frame

_DIGITS = 7  # decimals of positions, 0.1 µm
_AXIS_DIGITS = 4
_SWEPT = slice(4, 24, 4)  # postures along a path at which the whole arm is drawn


class SceneGraph:
    """Data from which the page draws an arm.

    Attributes:
        description: Everything that does not move, except the 3D shapes.
    """

    def __init__(self, model: Model, chain: Chain, extent: ArmExtent) -> None:
        self._model, self._chain = model, chain
        self._handles = ToolHandles(chain, tool_frame(model).approach_axis)
        steps = {link: chain.joints_to(link)[-1] for link in chain.frames if link != chain.base}
        self._positions = _JointPositions(list(steps.values()))
        self._camera: tuple[Camera, Fields] | None = None
        self._positions_along = lru_cache(1)(self._compute_along)
        capsules = capsules_of(model)
        self.description: Fields = {
            "kind": "graph",
            "links": [
                {
                    "name": link,
                    **_joint_fields(steps.get(link)),
                    "capsules": [
                        {
                            "ends": [each.start_m.tolist(), each.end_m.tolist()],
                            "radius": each.radius_m,
                        }
                        for each in capsules
                        if each.link == link
                    ],
                }
                for link in chain.frames
            ],
            "dials": [_dial_fields(chain, dial) for dial in joint_dials(chain, extent.home)],
            "tip": chain.tip,
            "floor": model.floor_m,
            "centre": extent.pivot_m.tolist(),
            "handles": self._handles.description,
            "size": float(np.linalg.norm(extent.own_m[1] - extent.own_m[0])),
        }

    @cached_property
    def shapes(self) -> Fields:
        """The shapes of each link, by name."""
        links = {link: link_shapes(self._model, link) for link in self._chain.frames}
        return {"kind": "shapes", "links": links}

    def fields(self, state: SceneState, *, handles: bool = False) -> Fields:
        """Return the fields of a scene: joint positions of arm and goal, camera, marks.

        ``handles`` are the axes (3, 3) of the tool's handles in the base frame.
        """
        others = state.other_joints if state.goal_other_joints is None else state.goal_other_joints
        marker, axes, region = None, None, state.region
        if state.marker is not None:
            marker = {
                "target": _rounded(state.marker.target_m),
                "nearest": _rounded(state.marker.nearest_m),
                "reached": state.marker.reached,
            }
        if handles:
            R = self._handles.axes(state.measured if state.goal is None else state.goal)
            axes = np.round(R, _AXIS_DIGITS).ravel().tolist()
        return {
            "camera": self._camera_fields(state.camera),
            "measured": self._positions.at(state.measured, state.other_joints),
            "goal": self._positions.at(state.goal, others)
            if state.goal is not None and state.shows_goal
            else None,
            "marker": marker,
            "handles": axes,
            "hover": state.hover,
            "grabbed": state.grabbed,
            "behind": state.behind,
            "picked": state.picked,
            "refused_pair": state.refused_pair,
            **self._path_fields(state),
            "region": None if region is None else region.rings,
            "region_pose": None if region is None else row_major(region.T_world_plane),
        }

    def _camera_fields(self, camera: Camera) -> Fields:
        """Return a camera's fields, cached because a drag keeps its camera."""
        if self._camera is None or self._camera[0] is not camera:
            self._camera = camera, _camera_fields(camera)
        return self._camera[1]

    def _path_fields(self, state: SceneState) -> Fields:
        path = state.path
        if path is None or path.plan is None or not state.shows_goal:
            return {"path": None, "swept": None}
        along = self._positions_along(path)
        swept = None if state.is_choosing else along[_SWEPT]
        fields = {"number": path.number, "joints": along, "several": path.run is not None}
        return {"path": fields, "swept": swept}

    def _compute_along(self, path: PlannedPath) -> list[list[float]]:
        return [self._positions.at(q, others) for q, others in path.postures]


class _JointPositions:
    """Positions of the joints that are not fixed, in the order of their links.

    Args:
        steps: The joint before each link.
    """

    def __init__(self, steps: list[ChainJoint]) -> None:
        moving = [step for step in steps if step.joint.kind is not JointType.FIXED]
        self._columns = [step.column for step in moving]
        self._scales = np.array([step.scale for step in moving])
        self._shifts = np.array([step.shift for step in moving])
        self._others = [(i, step.joint) for i, step in enumerate(moving) if not step.scale]

    def at(self, q: Vector, others: Mapping[str, float]) -> list[float]:
        """Compute the positions, rad or m, from q (dof,) and ``others``: other joints by name."""
        at: Vector = self._scales * q[self._columns] + self._shifts
        for i, joint in self._others:
            other = other_joint_position(joint, others)
            at[i] = at[i] if other is None else other
        return _rounded(at)


def _rounded(numbers: Vector) -> list[float]:
    return np.round(numbers, _DIGITS).tolist()


def _joint_fields(step: ChainJoint | None) -> Fields:
    """Return the joint of a link to its parent; the base has no parent."""
    if step is None:
        return {"parent": None, "origin": row_major(np.eye(4)), "joint": "fixed"}
    joint = step.joint
    return {
        "parent": joint.parent,
        "origin": row_major(joint.origin),
        "joint": joint.kind.value,
        "axis": joint.axis.tolist(),
    }


def _dial_fields(chain: Chain, dial: JointDial) -> Fields:
    """Return a joint's range, and the distances that count as near and at a limit."""
    low, high = float(chain.lower_rad[dial.column]), float(chain.upper_rad[dial.column])
    limited = math.isfinite(high - low)
    unit = "m" if dial.is_prismatic else "rad"
    return {
        "joint": dial.name,
        "link": dial.step.joint.child,
        "needle": dial.needle.tolist(),
        "slides": dial.is_prismatic,
        "range": [low, high] if limited else None,
        "at": at_distance(low, high, unit),
        "near": near_distance(low, high, unit),
    }


def _camera_fields(camera: Camera) -> Fields:
    return {
        "pose": row_major(make_pose(camera.eye_m, camera.R_world_view)),
        "scale_px": camera.scale_px,
        "perspective": camera.perspective,
        "near_m": NEAR_PLANE_M,
        "size": [camera.viewport.width_px, camera.viewport.height_px],
        "lens": camera.fields() if isinstance(camera, LensCamera) else None,
    }
