"""Status messages for the page: modes, joints, health, notices."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ikservo.arm import JointState
from ikservo.calibration import format_position
from ikservo.kinematics.arrays import Vector
from ikservo.model import Model
from ikservo.model.joint_limits import at_limit, near_limit
from ikservo.model.model import HealthLimits
from ikservo.view.arm_thread import ArmThread
from ikservo.view.auth import Permission
from ikservo.view.calibration import calibration_view
from ikservo.view.interaction import Interaction
from ikservo.view.labels import (
    candidate_rows,
    format_point,
    format_solve_time,
    format_supply,
    health_rows,
    insight_rows,
)
from ikservo.view.posture_insights import PostureAnalysis
from ikservo.view.server import Frame
from ikservo.view.snapshot import ArmSnapshot
from ikservo.view.viewpoints import ViewName

__all__ = ["arm_frame", "banner", "health", "joint_readouts", "messages", "mode", "status_frame"]


_MAX_STATUS_MESSAGES = 12


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
