"""The scene renderer: everything the page draws in one frame.

Made once for an arm, then asked for every frame::

    theatre = Theatre(model, arm.chain, {state.name: state.limit_from for state in states})
    items = theatre.items(Moment(camera, measured=q, goal=q_goal, aim=aim, hover="forearm", …))

Items are painted from first to last, see ``items``. Styles, back to front: ``floor``, ``grid``,
``reach``, ``keep_out``, ``picked``, the links of the goal ``ghost`` and of the arm ``measured``
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

__all__ = ["SceneRenderer", "SceneState"]

_SAME_RAD = 2e-3
_TIP_PX = 4.0


@dataclass(frozen=True, slots=True, eq=False)
class SceneState:
    """What is to be shown now.

    Attributes:
        camera: Where from.
        measured: Joints (dof,) as the servos report them, rad or m.
        goal: Joints (dof,) the arm is sent to; None while there is no goal.
        aim: The target, if there is one.
        reach: The region of the shown plane, if it is known.
        hover: The link under the pointer.
        grabbed: The link that is being pulled.
        behind: Whether the hovered link was chosen behind others: its outline is drawn over them.
        picked: The object of the scene under the pointer.
        other_joints: Positions of joints beside the way to the tip, as the gripper's.
    """

    camera: Camera
    measured: Vector
    goal: Vector | None = None
    aim: TargetMarker | None = None
    reach: ReachableRegion | None = None
    hover: str | None = None
    grabbed: str | None = None
    behind: bool = False
    picked: str | None = None
    other_joints: Mapping[str, float] = field(default_factory=dict[str, float])


class SceneRenderer:
    """An arm and its surroundings, laid out for drawing.

    Args:
        model: The arm.
        chain: Its joints inside its own, calibrated limits; the model's if None.
        limit_from: Where each joint's limits come from.
    """

    def __init__(
        self, model: Model, chain: Chain | None = None, limit_from: Mapping[str, str] | None = None
    ) -> None:
        self.chain = model.chain if chain is None else chain
        self.stage = arm_extent(model)
        self._model, self._limit_from = model, dict(limit_from or {})
        self._outlines = SilhouetteRenderer(capsules_of(model))
        self._dials = joint_dials(self.chain, self.stage.home)
        self._arcs = JointArcs(self.chain, self._dials)

    def draw(self, moment: SceneState) -> list[DrawItem]:
        """Return what there is to paint, from back to front."""
        return [*self.backdrop(moment), *self.foreground(moment)]

    def backdrop(self, moment: SceneState) -> list[DrawItem]:
        """Return what changes with camera and region only: most of the numbers of a picture."""
        floor_m = self._model.floor_m
        items = [] if floor_m is None else draw_floor(self.stage, moment.camera, floor_m)
        if moment.reach is not None:
            items.append(draw_region(moment.reach, moment.camera))
        return items + [draw_box(moment.camera, box) for box in self._model.keep_out]

    def foreground(self, moment: SceneState) -> list[DrawItem]:
        """Return the arm and all that moves with it."""
        poses = link_poses(self.chain, moment.measured, moment.other_joints)
        boxes = [box for box in self._model.keep_out if box.name == moment.picked]
        return [
            *(draw_box(moment.camera, box, "picked") for box in boxes),
            *self._draw_goal(moment),
            *self._draw_arm(moment, poses),
            *self._draw_ranges(moment, poses),
            *_draw_markers(moment, poses[self.chain.tip][:3, 3]),
            *draw_scale(moment.camera),
        ]

    def _draw_goal(self, moment: SceneState) -> list[DrawItem]:
        """Return the goal, where it is not where the arm is."""
        goal = moment.goal
        if goal is None or float(np.abs(goal - moment.measured).max()) < _SAME_RAD:
            return []
        poses = link_poses(self.chain, goal, moment.other_joints)
        seen = self._outlines.outlines_from(moment.camera, poses)
        return [polygon("ghost", outline.rings, link=outline.link) for outline in seen]

    def _draw_arm(self, moment: SceneState, poses: Mapping[str, Matrix]) -> list[DrawItem]:
        seen = self._outlines.outlines_from(moment.camera, poses)
        links = [polygon(_style_of(each.link, moment), each.rings, link=each.link) for each in seen]
        over = [each for each in seen if moment.behind and each.link == moment.hover]
        return [*links, *(polygon("behind", each.rings) for each in over)]

    def _draw_ranges(self, moment: SceneState, poses: Mapping[str, Matrix]) -> list[DrawItem]:
        styles = [self._limit_side(moment, dial.column) for dial in self._dials]
        drawn = self._arcs.draw_arcs(moment.measured, poses, moment.camera, styles)
        for dial, items in zip(self._dials, drawn, strict=True):
            items[0]["says"] = self._dial_label(moment, dial)
        return [item for items in drawn for item in items]

    def _dial_label(self, moment: SceneState, dial: JointDial) -> str:
        at, source = float(moment.measured[dial.column]), self._limit_from.get(dial.name)
        return describe_range(self.chain, dial.column, at, source or "arm file")

    def _limit_side(self, moment: SceneState, column: int) -> str:
        """Return how near a limit a joint is, or is being sent."""
        styles = [limit_proximity(self.chain, moment.measured, column)]
        if moment.goal is not None:
            styles.append(limit_proximity(self.chain, moment.goal, column))
        return next((style for style in ("red", "amber") if style in styles), "limit")


def _style_of(link: str, moment: SceneState) -> str:
    return "grabbed" if link == moment.grabbed else "hover" if link == moment.hover else "measured"


def _draw_markers(moment: SceneState, tip_m: Vector) -> list[DrawItem]:
    """Return the tip and the target."""
    camera = moment.camera
    items = [circle("tip", camera.project(tip_m)[0], _TIP_PX)]
    return items if moment.aim is None else items + draw_target(moment.aim, camera)
