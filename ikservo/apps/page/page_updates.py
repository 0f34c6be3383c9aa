"""Compose the frames of each client: the arm's description once, status and scene on change."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache, partial

import numpy as np

from ikservo.apps.page.dragging.interaction import Interaction
from ikservo.apps.page.dragging.labels import (
    candidate_rows,
    condition_rows,
    format_solve_time,
    format_supply,
    health_rows,
    insight_rows,
    path_rows,
)
from ikservo.apps.page.dragging.snapshot import ArmSnapshot, LogEntry, StopNotice
from ikservo.apps.page.drawing.reachable_region import (
    ReachableRegionCache,
    SlicePlane,
    slice_plane,
)
from ikservo.apps.page.drawing.scene_graph import SceneGraph
from ikservo.apps.page.drawing.view_picture import SceneState
from ikservo.apps.page.messages.page_messages import BadMessageError
from ikservo.apps.page.panels.camera_view import CameraView
from ikservo.apps.page.picking.link_poses import link_poses
from ikservo.apps.page.picking.projection import Camera
from ikservo.apps.page.picking.viewpoints import ViewName, arm_extent, available_views, make_camera
from ikservo.apps.page.picking.visibility import (
    PostureAnalyser,
    VisibilityChecker,
)
from ikservo.apps.page.running.arm_thread import ArmThread
from ikservo.apps.page.running.calibration_panel import calibration_fields
from ikservo.apps.page.running.limp_picture import show_calibration
from ikservo.apps.page.server.auth import Permission
from ikservo.apps.page.server.message_age_and_rate import Client
from ikservo.apps.page.server.server import Frame
from ikservo.arm import Arm, JointState
from ikservo.calibration import format_position
from ikservo.calibration.joint_limits import at_distance, limit_distance, near_limit
from ikservo.clock import Clock
from ikservo.control.stillness import StillnessDetector
from ikservo.errors import IkservoError, format_point
from ikservo.kinematics.arrays import Vector
from ikservo.model import Model
from ikservo.model.arm_model import HealthLimits

_MAX_STATUS_MESSAGES = 12

_STATUS_PERIOD_S, _HEARTBEAT_PERIOD_S = 0.066, 0.1
_KEPT_CAMERAS = 16  # one per client; the camera of the side view turns with the arm
# An arm at rest moves less than this between two status frames.
_STANDS = StillnessDetector(window_s=0.0, tolerance=2e-3, least_readings=2)


def mode(snapshot: ArmSnapshot, *, live: bool) -> str:
    """Return the mode: ``calibration``, ``stopped``, ``busy``, ``live`` or ``preview``."""
    if snapshot.calibration:
        return "calibration"
    if snapshot.stop_notice:
        return "stopped"
    if snapshot.activity:
        return "busy"
    return "live" if live else "preview"


def banner(snapshot: ArmSnapshot, fallback: StopNotice | None) -> dict[str, str] | None:
    """Return the reason for a stop or for the end of Live, and what the user can do."""
    notice = snapshot.stop_notice or fallback
    if notice is None or snapshot.calibration:
        return None
    action = "acknowledge" if snapshot.stop_notice else "go_live"
    return {"message": notice.message, "hint": notice.hint, "action": action}


def messages(
    snapshot: ArmSnapshot, interaction_messages: Sequence[LogEntry]
) -> list[dict[str, object]]:
    """Return the latest messages from the arm and from the interaction, ordered by time."""
    entries = sorted((*snapshot.messages, *interaction_messages), key=lambda entry: entry.time_s)
    return [
        {"message": entry.message, "level": entry.level, "time_s": round(entry.time_s, 1)}
        for entry in entries[-_MAX_STATUS_MESSAGES:]
    ]


def joint_readouts(
    model: Model, snapshot: ArmSnapshot, goal: Vector | None
) -> list[dict[str, object]]:
    """Return a meter for each joint: its calibrated range, measured position and goal."""
    shown = snapshot.measured if goal is None else goal
    rows = zip(snapshot.states, snapshot.measured, shown, strict=True)
    return [_joint_meter_fields(model, state, float(at), float(to)) for state, at, to in rows]


def health(states: Sequence[JointState], limits: HealthLimits) -> dict[str, object]:
    """Return the telemetry of the servos."""
    volts = [state.voltage_v for state in states]
    return {"supply": format_supply(volts) if volts else "", "joints": health_rows(states, limits)}


def _joint_meter_fields(model: Model, state: JointState, at: float, to: float) -> dict[str, object]:
    unit = model.joint(state.name).joint_map.unit
    low, high = state.lower_rad, state.upper_rad
    is_beyond = limit_distance(at, low, high) < -at_distance(low, high, unit)
    is_wrong = is_beyond and state.torque  # a limp joint may sag past its limit
    nearness = "beyond" if is_wrong else "near" if near_limit(at, low, high, unit) else ""
    if not math.isfinite(high - low):
        low, high = at - math.pi, at + math.pi

    def fraction(position: float) -> float:
        return round(min(max((position - low) / max(high - low, 1e-9), 0.0), 1.0), 4)

    return {
        "name": state.name,
        "text": format_position(at, unit),
        "fraction": fraction(at),
        "goal": fraction(to),
        "state": nearness,
    }


def arm_frame(
    arm_thread: ArmThread,
    interaction: Interaction,
    permission: Permission,
    views: Sequence[ViewName],
    now_s: float,
) -> Frame:
    """Return the frame with all data that do not change while an arm is open."""
    arm, model = arm_thread.arm, arm_thread.arm.model
    return {
        "kind": "arm_info",
        "title": model.title,
        "port": arm.port_name.partition("?")[0].partition(":/")[0],
        "permission": permission.value,
        "views": views,
        "poses": known_poses(arm),
        "speeds": list(model.speeds),
        "solvers": interaction.solvers,
        "joints": [state.name for state in arm_thread.snapshot.states],
        "ranges": interaction.range_fields(),
        "gripper": model.gripper is not None,
        "chain": list(arm.chain.names),
        "zeros": arm.context.zeros.name.lower(),
        "now_s": round(now_s, 3),
    }


def known_poses(arm: Arm) -> list[str]:
    """Return the names of the arm's poses, without taught poses if their file is damaged."""
    try:
        return list(arm.poses.all_poses())
    except IkservoError:
        return list(arm.model.poses)


def status_frame(
    arm_thread: ArmThread,
    interaction: Interaction,
    step: int,
    controller: str,
    now_s: float,
    posture: Sequence[tuple[str, str, str]] = (),
    fallback: StopNotice | None = None,
) -> Frame:
    """Return the frame with all data that the page shows next to the drawing.

    ``step`` is the shown solver step, ``controller`` the page in control (``you``, ``other``
    or ``none``), ``fallback`` the reason why Live has ended, until the user has answered.
    """
    snapshot, live, trace = arm_thread.snapshot, arm_thread.command.live, interaction.solver_trace
    return {
        "kind": "status",
        "mode": mode(snapshot, live=live),
        "live": live,
        "activity": snapshot.activity.text if snapshot.activity else "",
        "left": snapshot.activity.left if snapshot.activity else "",
        "stop_count": snapshot.stop_count,
        "age_s": math.floor(now_s - snapshot.read_s),
        "controller": controller,
        "speed": arm_thread.command.speed,
        "banner": banner(snapshot, fallback),
        "refused": interaction.refusal is not None,
        "target": interaction.goal is not None,
        "path": None if interaction.path is None else interaction.path.number,
        "undo": interaction.history.can_undo,
        "redo": interaction.history.can_redo,
        "joints": joint_readouts(arm_thread.arm.model, snapshot, interaction.goal),
        "goals": interaction.goal_fields(snapshot.measured),
        "tool": interaction.tool_fields(snapshot.measured),
        "health": health(snapshot.states, arm_thread.arm.model.health),
        "tip": _tip_rows(arm_thread, interaction),
        "posture": posture,
        "under": candidate_rows(interaction.under, interaction.chosen),
        "solver": {
            "name": interaction.solver,
            "time": "" if interaction.solve_s is None else format_solve_time(interaction.solve_s),
            "text": interaction.solver_text if trace is None else trace.format_step(step),
        },
        "preference": interaction.preference.page_fields(interaction.solver),
        "messages": messages(snapshot, interaction.messages),
        "calibration": calibration_fields(snapshot.calibration) if snapshot.calibration else None,
    }


def _tip_rows(arm_thread: ArmThread, interaction: Interaction) -> list[tuple[str, str, str]]:
    marker = interaction.marker
    q = arm_thread.arm.joint_index.chain_joints(arm_thread.snapshot.measured)
    tip_m = arm_thread.arm.chain.forward(q)[:3, 3]
    rows = [("tip", format_point(tip_m), "")]
    if marker is not None:
        good = marker.reached and interaction.refusal is None
        of_link = "" if marker.frame is None else f" of {marker.frame}"  # the grabbed link
        what, at = f"target{of_link}", format_point(marker.target_m)
        rows.append((what, at, "good" if good else "bad"))
        if not marker.reached:
            rows.append(
                ("nearest", f"{format_point(marker.nearest_m)}, {marker.gap_m * 1000:.0f} mm", "")
            )
    rows += path_rows(interaction.path)
    goal = interaction.shown_goal
    if arm_thread.command.live and goal is not None:
        off_m = float(np.linalg.norm(arm_thread.arm.chain.forward(goal)[:3, 3] - tip_m))
        rows.append(("off", f"{off_m * 1000:.1f} mm", ""))
    model = arm_thread.arm.model
    return rows + condition_rows(arm_thread.snapshot.states, model.supply_v, model.health)


class FrameComposer:
    """Composer of scene and status frames from the arm thread's snapshot, for each client's view.

    Attributes:
        extent: The extent of the arm.
        views: The names of the arm's views.
    """

    def __init__(
        self,
        arm_thread: ArmThread,
        interaction: Interaction,
        clock: Clock,
        camera_view: CameraView | None = None,
    ) -> None:
        self._lease = arm_thread.lease
        self._arm_thread, self._interaction, self._clock = arm_thread, interaction, clock
        arm = arm_thread.arm
        self.extent = arm_extent(arm.model)
        self.show_camera(camera_view)
        self._make_camera = lru_cache(_KEPT_CAMERAS)(partial(make_camera, self.extent))
        self._graph = SceneGraph(arm.model, arm.chain, self.extent)
        self._regions = ReachableRegionCache(arm.chain)
        self._analyser = PostureAnalyser(arm.chain, VisibilityChecker(arm.model), clock)
        self._stillness = _STANDS
        self._index = arm.joint_index

    def show_camera(self, camera_view: CameraView | None) -> None:
        """Offer the picture of a calibrated camera as a view; None withdraws it."""
        self._camera_view = camera_view
        self.views: tuple[ViewName, ...] = available_views(self.extent)
        if camera_view is not None:
            self.views += ("camera",)

    def close(self) -> None:
        """Cancel the background computations."""
        self._regions.close()
        self._analyser.close()

    def camera_view(self, client: Client) -> CameraView | None:
        """Return the camera whose picture a client views; None in other views."""
        return self._camera_view if client.view.name == "camera" else None

    def camera(self, client: Client) -> Camera:
        """Return a client's camera; during a drag, the camera of the client in control stays fixed.

        Raises:
            BadMessageError: The page has not sent the size of its drawing.
        """
        if client.viewport is None:
            raise BadMessageError("The page has not sent the size of its drawing.", "Reload it.")
        kept_camera = self._interaction.camera
        is_own = self._lease.is_held_by(client.lease)
        if is_own and kept_camera is not None and kept_camera.viewport == client.viewport:
            return kept_camera
        picture = self.camera_view(client)
        if picture is not None:
            return picture.camera(client.viewport)
        q = self._index.chain_joints(self._arm_thread.snapshot.measured)
        yaw_rad = self.extent.yaw_rad(q) if client.view.name == "side" else 0.0
        return self._make_camera(client.view, client.viewport, yaw_rad)

    def compose(
        self, client: Client, controller: str, fallback: StopNotice | None = None
    ) -> list[Frame]:
        """Return the new frames for a client."""
        frames: list[Frame] = []
        if "arm_info" not in client.sent:
            client.sent["arm_info"] = True
            now_s = self._clock.now_s()
            frames.append(
                arm_frame(self._arm_thread, self._interaction, client.permission, self.views, now_s)
            )
        if client.viewport is not None:
            frames += self._scene_frames(client)
        return frames + self._status_frames(client, controller, fallback)

    def _status_frames(
        self, client: Client, controller: str, fallback: StopNotice | None
    ) -> list[Frame]:
        if not self._is_due(client, "status", _STATUS_PERIOD_S):
            return []
        now_s = self._clock.now_s()
        step = self._interaction.trace_step(now_s)
        snapshot, analysis = self._arm_thread.snapshot, None
        q = self._index.chain_joints(snapshot.measured)
        if client.viewport is not None:  # analyse the arm at rest, from the client's camera
            self._stillness = self._stillness.add_joints(now_s, q.tolist())
            idle = self._stillness.is_at_rest() and self._interaction.camera is None
            others = self._index.by_name(snapshot.measured)
            find_poses = partial(link_poses, self._arm_thread.arm.chain, q, others)
            camera = self.camera(client)
            analysis = self._analyser.get(client.number, q, find_poses, camera, idle=idle)
        posture = insight_rows(self._analyser.conditioning(q), analysis)
        status = status_frame(
            self._arm_thread, self._interaction, step, controller, now_s, posture, fallback
        )
        return client.unsent(status)

    def _scene_frames(self, client: Client) -> list[Frame]:
        """Return the scene if anything changed or the heartbeat is due."""
        snapshot, interaction = self._arm_thread.snapshot, self._interaction
        camera, plane = self.camera(client), self._tip_plane(client)
        idle = interaction.camera is None
        region = None if plane is None else self._regions.get(plane, idle=idle)
        limp = [joint.name for joint in snapshot.states if not joint.torque]
        fingerprint = (
            snapshot.measured.tobytes(),
            tuple(limp),
            interaction.revision,
            interaction.trace_step(self._clock.now_s()),
            client.view,
            client.viewport,
            client.webgl,
            client.height_m,
            self._has_handles(client),
            region and region.fingerprint,
        )
        heartbeat_due = self._is_due(client, "scene", _HEARTBEAT_PERIOD_S, peek=True)
        if client.sent.get("scene") == fingerprint and not heartbeat_due:
            return []
        client.sent["scene"], client.sent_s["scene"] = fingerprint, self._clock.now_s()
        goal = interaction.drawn_goal
        state = SceneState(
            camera,
            self._index.chain_joints(snapshot.measured),
            goal=None if goal is None else self._index.chain_joints(goal),
            path=interaction.path,
            is_choosing=interaction.is_choosing,
            marker=interaction.marker,
            region=region,
            hover=interaction.hover,
            grabbed=interaction.grabbed_link,
            behind=interaction.chosen > 0,
            picked=interaction.picked_object,
            refused_pair=None if interaction.refusal is None else interaction.refusal.pair,
            other_joints=self._index.by_name(snapshot.measured),
            goal_other_joints=None if goal is None else self._index.by_name(goal),
        )
        if snapshot.calibration is not None:
            state = show_calibration(state, snapshot.calibration, self._arm_thread.arm.model)
        picture = self.camera_view(client)
        refusal, trace = interaction.refusal, interaction.solver_trace
        scene = {
            "kind": "scene",
            "webgl": client.webgl,
            "picture_trouble": None if picture is None else picture.trouble,
            "tip_shows": None if picture is None else picture.tip_shows,
            "tip_clicks": 0 if picture is None else picture.tip_clicks,
            "refusal": None if refusal is None or interaction.goal is None else refusal.reason,
            "limp": limp,
            "trace": None if trace is None else trace.page_fields,
            "trace_step": interaction.trace_step(self._clock.now_s()),
            **self._graph.fields(state, handles=self._has_handles(client)),
        }
        return [*self._arm_frames(client), scene]

    def _arm_frames(self, client: Client) -> list[Frame]:
        """Return the frames about the arm that a client still needs before its next scene."""
        frames: list[Frame] = []
        if client.sent.get("graph") is not self._graph:
            client.sent["graph"] = self._graph
            frames.append(self._graph.description)
        if client.webgl and client.sent.get("shapes") is not self._graph:
            client.sent["shapes"] = self._graph
            frames.append(self._graph.shapes)
        return frames

    def _has_handles(self, client: Client) -> bool:
        """Check whether a client can move the tool by its handles now."""
        snapshot = self._arm_thread.snapshot
        moves = not (snapshot.stop_notice or snapshot.calibration or snapshot.activity)
        return client.handles and moves and self._lease.is_held_by(client.lease)

    def plane_m(self, client: Client) -> Vector | None:
        """Return a point (3,) of the plane for clicks on the background; None: the tip's plane."""
        plane = self._tip_plane(client) if client.view.name == "side" else None
        return None if plane is None else plane.T_world_plane[:3, 3]

    def _tip_plane(self, client: Client) -> SlicePlane | None:
        """Return the plane in which the tip is dragged; it contains the tip of the goal, if any."""
        q = self._index.chain_joints(self._arm_thread.snapshot.measured)
        picture = self.camera_view(client)
        if picture is not None:
            z_m = picture.plane_m(client.height_m)
            return slice_plane(self.extent, "top", q, lambda: np.array([0.0, 0.0, z_m]))
        name = "side" if client.webgl else client.view.name
        goal, chain = self._interaction.shown_goal, self._arm_thread.arm.chain
        shown = q if goal is None else goal
        return slice_plane(self.extent, name, q, lambda: chain.forward(shown)[:3, 3])

    def _is_due(self, client: Client, kind: str, period_s: float, *, peek: bool = False) -> bool:
        now_s = self._clock.now_s()
        due = now_s - client.sent_s.get(kind, -1e9) >= period_s
        if due and not peek:
            client.sent_s[kind] = now_s
        return due
