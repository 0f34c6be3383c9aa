"""The scene renderer: everything the page draws in one frame.

Created once per arm, then called for every frame::

    renderer = SceneRenderer(model, arm.chain, {state.name: state.limit_from for state in states})
    items = renderer.draw(SceneState(camera, measured=q, goal=q_goal, marker=marker, …))

Items are in painting order, see ``draw_items``. Styles, back to front: ``floor``, ``grid``,
``reach``, ``keep_out``, ``picked``, the links of the goal ``ghost`` (``refused``, and those that
would touch something ``touching``) and of the arm ``measured``
(``hover`` and ``grabbed`` where the pointer is, ``behind`` over others), arcs ``limit`` |
``amber`` | ``red`` with ``needle`` and ``hub``, ``trace``, ``tip``, ``gap``, ``nearest``,
``target`` | ``target_far``, ``scale``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.model import Model
from ikservo.model.collision_model import capsules_of
from ikservo.view.camera import Camera
from ikservo.view.draw_items import DrawItem, TargetMarker, circle, draw_target, link_poses, polygon
from ikservo.view.joint_arcs import JointArcs, JointDial, joint_dials, limit_proximity
from ikservo.view.labels import describe_range
from ikservo.view.outlines import SilhouetteRenderer, draw_box, draw_floor, draw_scale
from ikservo.view.reachable_region import ReachableRegion, draw_region
from ikservo.view.viewpoints import arm_extent

__all__ = ["SceneRenderer", "SceneState", "draw_markers"]

_SAME_RAD = 2e-3
_TIP_PX = 4.0


@dataclass(frozen=True, slots=True, eq=False)
class SceneState:
    """What a frame shows.

    Attributes:
        camera: The camera.
        measured: Measured joints (dof,), rad or m.
        goal: Goal of the joints (dof,); None while there is no goal.
        marker: The target, if there is one.
        region: The reachable region of the shown plane, if it is available.
        hover: The link under the pointer.
        grabbed: The link that is being dragged.
        behind: Whether the hovered link was selected behind others: its outline is drawn on top.
        picked: The object of the scene under the pointer.
        refused_pair: What the goal would touch, if the guard refuses it; may be empty. None for a
            goal that is not refused.
        other_joints: Positions of joints that are not in the chain, such as the gripper's.
        goal_other_joints: Their goals; None where they stay.
    """

    camera: Camera
    measured: Vector
    goal: Vector | None = None
    marker: TargetMarker | None = None
    region: ReachableRegion | None = None
    hover: str | None = None
    grabbed: str | None = None
    behind: bool = False
    picked: str | None = None
    refused_pair: tuple[str, ...] | None = None
    other_joints: Mapping[str, float] = field(default_factory=dict[str, float])
    goal_other_joints: Mapping[str, float] | None = None

    @property
    def shows_goal(self) -> bool:
        """Return whether there is a goal that differs from where the arm is measured.

        What servos do not resolve makes no difference.
        """
        if self.goal is None:
            return False
        others = self.goal_other_joints or {}
        away = [abs(others[name] - at) for name, at in self.other_joints.items() if name in others]
        return max(float(np.abs(self.goal - self.measured).max()), *away, 0.0) >= _SAME_RAD


class SceneRenderer:
    """Draws an arm and its surroundings.

    Args:
        model: The arm.
        chain: Its joints inside its own, calibrated limits; the model's if None.
        limit_from: The source of each joint's limits.
    """

    def __init__(
        self, model: Model, chain: Chain | None = None, limit_from: Mapping[str, str] | None = None
    ) -> None:
        self.chain = model.chain if chain is None else chain
        self.extent = arm_extent(model)
        self._model, self._limit_from = model, dict(limit_from or {})
        self._outlines = SilhouetteRenderer(capsules_of(model))
        self._dials = joint_dials(self.chain, self.extent.home)
        self._arcs = JointArcs(self.chain, self._dials)

    def draw(self, state: SceneState) -> list[DrawItem]:
        """Return all items, from back to front."""
        return [*self.backdrop(state), *self.foreground(state)]

    def backdrop(self, state: SceneState) -> list[DrawItem]:
        """Return the items that change with camera and region only: most of a frame's data."""
        floor_m = self._model.floor_m
        items = [] if floor_m is None else draw_floor(self.extent, state.camera, floor_m)
        if state.region is not None:
            items.append(draw_region(state.region, state.camera))
        return items + [draw_box(state.camera, box) for box in self._model.keep_out]

    def foreground(self, state: SceneState) -> list[DrawItem]:
        """Return the items of the arm and everything that moves with it."""
        poses = link_poses(self.chain, state.measured, state.other_joints)
        marked = (state.picked, *(state.refused_pair or ()))
        picked_boxes = [box for box in self._model.keep_out if box.name in marked]
        return [
            *(draw_box(state.camera, box, "picked") for box in picked_boxes),
            *self._draw_goal(state),
            *self._draw_arm(state, poses),
            *self._draw_ranges(state, poses),
            *draw_markers(state, poses[self.chain.tip][:3, 3]),
            *draw_scale(state.camera),
        ]

    def _draw_goal(self, state: SceneState) -> list[DrawItem]:
        """Return the items of the goal, if it differs from the measured arm."""
        goal = state.goal
        others = state.other_joints if state.goal_other_joints is None else state.goal_other_joints
        if goal is None or not state.shows_goal:
            return []
        poses = link_poses(self.chain, goal, others)
        outlines = self._outlines.outlines_from(state.camera, poses)
        return [
            polygon(_goal_style(each.link, state.refused_pair), each.rings, link=each.link)
            for each in outlines
        ]

    def _draw_arm(self, state: SceneState, poses: Mapping[str, Matrix]) -> list[DrawItem]:
        outlines = self._outlines.outlines_from(state.camera, poses)
        links = [
            polygon(_style_of(each.link, state), each.rings, link=each.link) for each in outlines
        ]
        on_top = [each for each in outlines if state.behind and each.link == state.hover]
        return [*links, *(polygon("behind", each.rings) for each in on_top)]

    def _draw_ranges(self, state: SceneState, poses: Mapping[str, Matrix]) -> list[DrawItem]:
        styles = [self._limit_side(state, dial.column) for dial in self._dials]
        arcs = self._arcs.draw_arcs(state.measured, poses, state.camera, styles)
        for dial, items in zip(self._dials, arcs, strict=True):
            items[0]["label"] = self._dial_label(state, dial)
        return [item for items in arcs for item in items]

    def _dial_label(self, state: SceneState, dial: JointDial) -> str:
        at, source = float(state.measured[dial.column]), self._limit_from.get(dial.name)
        return describe_range(self.chain, dial.column, at, source or "arm file")

    def _limit_side(self, state: SceneState, column: int) -> str:
        """Return the style for the proximity of a joint's position and goal to its limits."""
        styles = [limit_proximity(self.chain, state.measured, column)]
        if state.goal is not None:
            styles.append(limit_proximity(self.chain, state.goal, column))
        return next((style for style in ("red", "amber") if style in styles), "limit")


def _style_of(link: str, state: SceneState) -> str:
    return "grabbed" if link == state.grabbed else "hover" if link == state.hover else "measured"


def _goal_style(link: str, refused_pair: tuple[str, ...] | None) -> str:
    if refused_pair is None:
        return "ghost"
    return "touching" if link in refused_pair else "refused"


def draw_markers(state: SceneState, tip_m: Vector) -> list[DrawItem]:
    """Return the items of the tip and the target."""
    camera = state.camera
    items = [circle("tip", camera.project(tip_m)[0], _TIP_PX)]
    if state.marker is None:
        return items
    refused = state.refused_pair is not None
    return items + draw_target(state.marker, camera, refused=refused)
