"""Compose what each client is sent: the arm once, status and scene as they change, as JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ikservo.arm import JointState
from ikservo.calibration import format_position
from ikservo.clock import Clock
from ikservo.kinematics.arrays import Vector
from ikservo.model import Model
from ikservo.model.model import HealthLimits, at_limit, near_limit
from ikservo.view.arm_thread import ArmThread
from ikservo.view.auth import Permission
from ikservo.view.calibration import calibration_view
from ikservo.view.camera import Camera
from ikservo.view.connection import Client
from ikservo.view.draw_items import DrawItem, link_poses
from ikservo.view.interaction import Interaction
from ikservo.view.labels import (
    candidate_rows,
    format_point,
    format_solve_time,
    format_supply,
    health_rows,
    insight_rows,
)
from ikservo.view.messages import BadMessageError
from ikservo.view.reachable_region import (
    ReachableRegion,
    ReachableRegionCache,
    SlicePlane,
    slice_plane,
)
from ikservo.view.scene import SceneRenderer, SceneState
from ikservo.view.server import Frame
from ikservo.view.snapshot import ArmSnapshot
from ikservo.view.viewpoints import ArmExtent, ViewName, available_views, make_camera
from ikservo.view.visibility import PostureAnalyser, PostureAnalysis, VisibilityChecker

__all__ = [
    "FrameComposer",
    "arm_frame",
    "banner",
    "health",
    "joint_readouts",
    "messages",
    "mode",
    "status_frame",
]

_MAX_STATUS_MESSAGES = 12

_STATUS_PERIOD_S, _HEARTBEAT_PERIOD_S = 0.066, 0.1
_AT_REST_RAD = 2e-3  # between two statuses


def mode(readout: ArmSnapshot, *, live: bool) -> str:
    """Return what the arm does: ``calibration``, ``stopped``, ``live`` or ``preview``."""
    if readout.talk:
        return "calibration"
    if readout.trouble:
        return "stopped"
    return "live" if live else "preview"


def banner(readout: ArmSnapshot) -> dict[str, str] | None:
    """Return why the arm holds until somebody has looked."""
    trouble = readout.trouble
    return None if trouble is None else {"message": trouble.message, "hint": trouble.hint}


def messages(readout: ArmSnapshot, said: Sequence[str]) -> list[dict[str, str]]:
    """Return the latest notes of the arm, and what became of the target."""
    return [
        {"message": words, "hint": "", "level": ""}
        for words in (*readout.notes, *said)[-_MAX_STATUS_MESSAGES:]
    ]


def joint_readouts(
    model: Model, readout: ArmSnapshot, goal: Vector | None
) -> list[dict[str, object]]:
    """Return a meter for each joint: its calibrated range, where it is and where it is sent."""
    wanted = readout.measured if goal is None else goal
    rows = zip(readout.states, readout.measured, wanted, strict=True)
    return [_joint_meter_fields(model, state, float(at), float(to)) for state, at, to in rows]


def health(states: Sequence[JointState], limits: HealthLimits) -> dict[str, object]:
    """Return how the servos are."""
    volts = [state.voltage_v for state in states]
    return {"supply": format_supply(volts) if volts else "", "joints": health_rows(states, limits)}


def _joint_meter_fields(model: Model, state: JointState, at: float, to: float) -> dict[str, object]:
    unit = model.joint(state.name).joint_map.unit
    low, high = state.lower_rad, state.upper_rad
    at_it, near_it = (check(at, low, high, unit) for check in (at_limit, near_limit))
    if not math.isfinite(high - low):
        low, high = at - math.pi, at + math.pi

    def share(position: float) -> float:
        return round(float(np.clip((position - low) / max(high - low, 1e-9), 0.0, 1.0)), 4)

    return {
        "name": state.name,
        "text": format_position(at, unit),
        "low": format_position(low, unit),
        "high": format_position(high, unit),
        "from": state.limit_from,
        "share": share(at),
        "goal": share(to),
        "state": "at" if at_it else "near" if near_it else "",
    }


def arm_frame(
    pilot: ArmThread, gestures: Interaction, right: Permission, views: Sequence[ViewName]
) -> Frame:
    """Return what does not change while an arm is open."""
    arm, model = pilot.arm, pilot.arm.model
    return {
        "kind": "arm",
        "title": model.title,
        "port": arm.port_name.partition("?")[0].partition(":/")[0],
        "right": right.value,
        "views": views,
        "poses": list(model.poses),
        "speeds": list(model.speeds),
        "solvers": gestures.solvers,
        "joints": [state.name for state in pilot.readout.states],
        "gripper": model.gripper is not None,
        "chain": list(arm.chain.names),
    }


def status_frame(
    pilot: ArmThread,
    gestures: Interaction,
    step: int,
    controller: str,
    insight: PostureAnalysis | None = None,
) -> Frame:
    """Return everything that the page says beside the drawing.

    Args:
        pilot: Whose readout it is.
        gestures: What the person in control is doing.
        step: Which step of a lesson is shown.
        controller: Who has control: ``you``, ``other`` or ``none``.
        insight: What is known of the arm where it rests; None while it moves.
    """
    readout, live, lesson = pilot.readout, pilot.command.live, gestures.solver_trace
    return {
        "kind": "status",
        "mode": mode(readout, live=live),
        "live": live,
        "controller": controller,
        "speed": pilot.command.speed,
        "banner": banner(readout),
        "joints": joint_readouts(pilot.arm.model, readout, gestures.goal),
        "health": health(readout.states, pilot.arm.model.health),
        "tip": _tip_rows(pilot, gestures),
        "posture": insight_rows(pilot.arm.chain, _measured_chain_joints(pilot), insight),
        "under": candidate_rows(gestures.under, gestures.chosen),
        "solver": {
            "name": gestures.solver,
            "time": "" if gestures.solve_s is None else format_solve_time(gestures.solve_s),
            "words": gestures.solver_words if lesson is None else lesson.format_step(step),
        },
        "preference": gestures.preference.page_fields(gestures.solver),
        "messages": messages(readout, gestures.messages),
        "calibration": calibration_view(pilot.arm.model, readout.talk) if readout.talk else None,
    }


def _tip_rows(pilot: ArmThread, gestures: Interaction) -> list[tuple[str, str, str]]:
    aim = gestures.aim
    rows = [("tip", format_point(_measured_tip_m(pilot)), "")]
    if aim is not None:
        rows.append(("target", format_point(aim.target_m), "good" if aim.reached else "bad"))
        if not aim.reached:
            rows.append(
                ("nearest", f"{format_point(aim.nearest_m)}, {aim.gap_m * 1000:.0f} mm", "")
            )
    return rows


def _measured_chain_joints(pilot: ArmThread) -> Vector:
    """Return the measured joints of the chain (dof,)."""
    names = [state.name for state in pilot.readout.states]
    return pilot.readout.measured[[names.index(name) for name in pilot.arm.chain.names]]


def _measured_tip_m(pilot: ArmThread) -> Vector:
    """Return where the tip is measured to be (3,)."""
    return pilot.arm.chain.forward(_measured_chain_joints(pilot))[:3, 3]


class FrameComposer:
    """Draws and words what the pilot sees, for each visitor's own view.

    Args:
        pilot: Whose readout is shown.
        gestures: What the person in control is doing.
        clock: Paces what is told.
    """

    def __init__(self, pilot: ArmThread, gestures: Interaction, clock: Clock) -> None:
        self._pilot, self._gestures, self._clock = pilot, gestures, clock
        arm = pilot.arm
        limits = {state.name: state.limit_from for state in pilot.readout.states}
        self._theatre = SceneRenderer(arm.model, arm.chain, limits)
        self._reaches = ReachableRegionCache(arm.chain)
        self._insights = PostureAnalyser(arm.chain, VisibilityChecker(arm.model))
        self._before: Vector | None = None
        names = [state.name for state in pilot.readout.states]
        self._columns = [names.index(name) for name in arm.chain.names]
        self._names = names

    @property
    def stage(self) -> ArmExtent:
        """Return the room that the arm moves in."""
        return self._theatre.stage

    def close(self) -> None:
        """Leave what is being worked out."""
        self._reaches.close()
        self._insights.close()

    def camera(self, visitor: Client) -> Camera:
        """Return what a visitor looks through; it stays while something is held.

        Raises:
            BadMessageError: The page has not told the size of its drawing.
        """
        if visitor.viewport is None:
            raise BadMessageError("The page has not told the size of its drawing.", "Reload it.")
        held = self._gestures.camera
        if held is not None and held.viewport == visitor.viewport:
            return held
        yaw_rad = self.stage.yaw_rad(self._chain_joints(self._pilot.readout.measured))
        return make_camera(self.stage, visitor.view, visitor.viewport, yaw_rad)

    def compose(self, visitor: Client, controller: str) -> list[Frame]:
        """Return what is new for a visitor."""
        frames: list[Frame] = []
        if "arm" not in visitor.sent:
            visitor.sent["arm"] = True
            views = available_views(self.stage)
            frames.append(arm_frame(self._pilot, self._gestures, visitor.right, views))
        if visitor.viewport is not None:
            frames += self._scene_frames(visitor)
        return frames + self._status_frames(visitor, controller)

    def _status_frames(self, visitor: Client, controller: str) -> list[Frame]:
        if not self._is_due(visitor, "status", _STATUS_PERIOD_S):
            return []
        step = self._gestures.trace_step(self._clock.now_s())
        insight = None if visitor.viewport is None else self._posture_analysis(visitor)
        status = status_frame(self._pilot, self._gestures, step, controller, insight)
        return self._frame_if_changed(visitor, status)

    def _posture_analysis(self, visitor: Client) -> PostureAnalysis | None:
        """Return what is known of the arm where it rests, as the visitor sees it."""
        readout = self._pilot.readout
        q, before = self._chain_joints(readout.measured), self._before
        self._before = q
        rests = before is not None and float(np.abs(q - before).max(initial=0.0)) < _AT_REST_RAD
        poses = link_poses(self._pilot.arm.chain, q, self._other_positions(readout))
        idle = rests and self._gestures.camera is None
        return self._insights.get(visitor.number, q, poses, self.camera(visitor), idle=idle)

    def _scene_frames(self, visitor: Client) -> list[Frame]:
        """Return the scene, if anything moved or the visitor has not heard for a while."""
        readout, gestures, camera = self._pilot.readout, self._gestures, self.camera(visitor)
        reach = self._reachable_region(visitor)
        now = (
            readout.measured.tobytes(),
            gestures.revision,
            gestures.trace_step(self._clock.now_s()),
            visitor.view,
            visitor.viewport,
            reach and reach.fingerprint,
        )
        alive = self._is_due(visitor, "scene", _HEARTBEAT_PERIOD_S, peek=True)
        if visitor.sent.get("scene") == now and not alive:
            return []
        visitor.sent["scene"], visitor.told_s["scene"] = now, self._clock.now_s()
        moment = SceneState(
            camera,
            self._chain_joints(readout.measured),
            goal=gestures.shown_goal,
            aim=gestures.aim,
            reach=reach,
            hover=gestures.hover,
            grabbed=gestures.grabbed_link,
            behind=gestures.chosen > 0,
            picked=gestures.picked_object,
            other_joints=self._other_positions(readout),
        )
        frame: dict[str, object] = {
            "kind": "scene",
            "items": self._theatre.foreground(moment) + self._solver_trace_items(camera),
            "hover": gestures.hover,
            "held": gestures.grabbed_link,
            "picked": gestures.picked_object,
        }
        behind = (camera.fingerprint, reach and reach.fingerprint)
        if visitor.sent.get("backdrop") != behind:
            visitor.sent["backdrop"] = behind
            frame["backdrop"] = self._theatre.backdrop(moment)
        return [frame]

    def _solver_trace_items(self, camera: Camera) -> list[DrawItem]:
        lesson = self._gestures.solver_trace
        step = self._gestures.trace_step(self._clock.now_s())
        return [] if lesson is None else lesson.items(step, camera)

    def plane_m(self, visitor: Client) -> Vector | None:
        """Return a point (3,) of the plane where clicks on nothing go; None: that of the tip."""
        plane = self._tip_plane(visitor) if visitor.view.name == "side" else None
        return None if plane is None else plane.T_world_plane[:3, 3]

    def _tip_plane(self, visitor: Client) -> SlicePlane | None:
        """Return the plane in which the tip is led: that of the goal, if there is one."""
        q, goal = self._chain_joints(self._pilot.readout.measured), self._gestures.shown_goal
        tip_m = self._pilot.arm.chain.forward(q if goal is None else goal)[:3, 3]
        return slice_plane(self.stage, visitor.view.name, q, tip_m)

    def _reachable_region(self, visitor: Client) -> ReachableRegion | None:
        plane = self._tip_plane(visitor)
        idle = self._gestures.camera is None
        return None if plane is None else self._reaches.get(plane, idle=idle)

    def _chain_joints(self, joints: Vector) -> Vector:
        return joints[self._columns]

    def _other_positions(self, readout: ArmSnapshot) -> dict[str, float]:
        return {name: float(at) for name, at in zip(self._names, readout.measured, strict=True)}

    def _frame_if_changed(self, visitor: Client, frame: Frame) -> list[Frame]:
        if visitor.sent.get("status") == frame:
            return []
        visitor.sent["status"] = frame
        return [frame]

    def _is_due(self, visitor: Client, kind: str, every_s: float, *, peek: bool = False) -> bool:
        now_s = self._clock.now_s()
        due = now_s - visitor.told_s.get(kind, -1e9) >= every_s
        if due and not peek:
            visitor.told_s[kind] = now_s
        return due
