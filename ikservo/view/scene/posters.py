"""When each visitor is told what: the arm once, its state as it changes, the scene as it moves."""

from __future__ import annotations

import numpy as np

from ikservo.clock import Clock
from ikservo.kinematics.se3 import Vector
from ikservo.view.camera.camera import Camera
from ikservo.view.camera.stage import Stage
from ikservo.view.camera.views import camera_of, views_of
from ikservo.view.pick.visibility import Visibility
from ikservo.view.scene.insights import Insight, Insights
from ikservo.view.scene.items import Item
from ikservo.view.scene.posing import link_poses
from ikservo.view.scene.reach import Reach, ShownPlane, shown_plane
from ikservo.view.scene.reaches import Reaches
from ikservo.view.scene.scene import Moment, Theatre
from ikservo.view.server.messages import BadMessageError
from ikservo.view.server.server import Frame
from ikservo.view.server.visitor import Visitor
from ikservo.view.session.gestures import Gestures
from ikservo.view.session.pilot import Pilot
from ikservo.view.session.readout import Readout
from ikservo.view.session.told import arm_told, status_told

__all__ = ["Posters"]

_STATUS_S, _ALIVE_S = 0.066, 0.1
_STILL_RAD = 2e-3  # between two statuses


class Posters:
    """Draws and words what the pilot sees, for each visitor's own view.

    Args:
        pilot: Whose readout is shown.
        gestures: What the person in control is doing.
        clock: Paces what is told.
    """

    def __init__(self, pilot: Pilot, gestures: Gestures, clock: Clock) -> None:
        self._pilot, self._gestures, self._clock = pilot, gestures, clock
        arm = pilot.arm
        limits = {state.name: state.limit_from for state in pilot.readout.states}
        self._theatre = Theatre(arm.model, arm.chain, limits)
        self._reaches = Reaches(arm.chain)
        self._insights = Insights(arm.chain, Visibility(arm.model))
        self._before: Vector | None = None
        names = [state.name for state in pilot.readout.states]
        self._columns = [names.index(name) for name in arm.chain.names]
        self._names = names

    @property
    def stage(self) -> Stage:
        """Return the room that the arm moves in."""
        return self._theatre.stage

    def close(self) -> None:
        """Leave what is being worked out."""
        self._reaches.close()
        self._insights.close()

    def camera(self, visitor: Visitor) -> Camera:
        """Return what a visitor looks through; it stays while something is held.

        Raises:
            BadMessageError: The page has not told the size of its drawing.
        """
        if visitor.viewport is None:
            raise BadMessageError("The page has not told the size of its drawing.", "Reload it.")
        held = self._gestures.camera
        if held is not None and held.viewport == visitor.viewport:
            return held
        yaw_rad = self.stage.yaw_rad(self._q(self._pilot.readout.measured))
        return camera_of(self.stage, visitor.view, visitor.viewport, yaw_rad)

    def frames(self, visitor: Visitor, controller: str) -> list[Frame]:
        """Return what is new for a visitor."""
        frames: list[Frame] = []
        if "arm" not in visitor.told:
            visitor.told["arm"] = True
            views = views_of(self.stage)
            frames.append(arm_told(self._pilot, self._gestures, visitor.right, views))
        if visitor.viewport is not None:
            frames += self._scene(visitor)
        return frames + self._status(visitor, controller)

    def _status(self, visitor: Visitor, controller: str) -> list[Frame]:
        if not self._due(visitor, "status", _STATUS_S):
            return []
        step = self._gestures.step(self._clock.now_s())
        insight = None if visitor.viewport is None else self._insight(visitor)
        status = status_told(self._pilot, self._gestures, step, controller, insight)
        return self._if_new(visitor, status)

    def _insight(self, visitor: Visitor) -> Insight | None:
        """Return what is known of the arm where it rests, as the visitor sees it."""
        readout = self._pilot.readout
        q, before = self._q(readout.measured), self._before
        self._before = q
        rests = before is not None and float(np.abs(q - before).max(initial=0.0)) < _STILL_RAD
        poses = link_poses(self._pilot.arm.chain, q, self._beside(readout))
        idle = rests and self._gestures.camera is None
        return self._insights.get(visitor.number, q, poses, self.camera(visitor), idle=idle)

    def _scene(self, visitor: Visitor) -> list[Frame]:
        """Return the scene, if anything moved or the visitor has not heard for a while."""
        readout, gestures, camera = self._pilot.readout, self._gestures, self.camera(visitor)
        reach = self._reach(visitor)
        now = (
            readout.measured.tobytes(),
            gestures.stamp,
            gestures.step(self._clock.now_s()),
            visitor.view,
            visitor.viewport,
            reach and reach.fingerprint,
        )
        alive = self._due(visitor, "scene", _ALIVE_S, peek=True)
        if visitor.told.get("scene") == now and not alive:
            return []
        visitor.told["scene"], visitor.told_s["scene"] = now, self._clock.now_s()
        moment = Moment(
            camera,
            self._q(readout.measured),
            goal=gestures.shown_goal,
            aim=gestures.aim,
            reach=reach,
            hover=gestures.hover,
            grabbed=gestures.grabbed,
            behind=gestures.chosen > 0,
            picked=gestures.picked,
            beside=self._beside(readout),
        )
        frame: dict[str, object] = {
            "kind": "scene",
            "items": self._theatre.foreground(moment) + self._lesson_items(camera),
            "hover": gestures.hover,
            "held": gestures.grabbed,
            "picked": gestures.picked,
        }
        behind = (camera.fingerprint, reach and reach.fingerprint)
        if visitor.told.get("backdrop") != behind:
            visitor.told["backdrop"] = behind
            frame["backdrop"] = self._theatre.backdrop(moment)
        return [frame]

    def _lesson_items(self, camera: Camera) -> list[Item]:
        lesson = self._gestures.lesson
        step = self._gestures.step(self._clock.now_s())
        return [] if lesson is None else lesson.items(step, camera)

    def plane_m(self, visitor: Visitor) -> Vector | None:
        """Return a point (3,) of the plane where clicks on nothing go; None: that of the tip."""
        plane = self._plane(visitor) if visitor.view.name == "side" else None
        return None if plane is None else plane.T_world_plane[:3, 3]

    def _plane(self, visitor: Visitor) -> ShownPlane | None:
        """Return the plane in which the tip is led: that of the goal, if there is one."""
        q, goal = self._q(self._pilot.readout.measured), self._gestures.shown_goal
        tip_m = self._pilot.arm.chain.forward(q if goal is None else goal)[:3, 3]
        return shown_plane(self.stage, visitor.view.name, q, tip_m)

    def _reach(self, visitor: Visitor) -> Reach | None:
        plane = self._plane(visitor)
        idle = self._gestures.camera is None
        return None if plane is None else self._reaches.get(plane, idle=idle)

    def _q(self, joints: Vector) -> Vector:
        return joints[self._columns]

    def _beside(self, readout: Readout) -> dict[str, float]:
        return {name: float(at) for name, at in zip(self._names, readout.measured, strict=True)}

    def _if_new(self, visitor: Visitor, frame: Frame) -> list[Frame]:
        if visitor.told.get("status") == frame:
            return []
        visitor.told["status"] = frame
        return [frame]

    def _due(self, visitor: Visitor, kind: str, every_s: float, *, peek: bool = False) -> bool:
        now_s = self._clock.now_s()
        due = now_s - visitor.told_s.get(kind, -1e9) >= every_s
        if due and not peek:
            visitor.told_s[kind] = now_s
        return due
