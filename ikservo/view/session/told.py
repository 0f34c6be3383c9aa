"""What the page is told in words and numbers: the arm once, its state as it changes."""

from __future__ import annotations

from collections.abc import Sequence

from ikservo.kinematics.se3 import Vector
from ikservo.view.camera.views import ViewName
from ikservo.view.scene.insight_words import insight_rows
from ikservo.view.scene.insights import Insight
from ikservo.view.scene.texts import point, solver_words
from ikservo.view.scene.under_words import under_rows
from ikservo.view.server.server import Frame
from ikservo.view.server.visitors import Right
from ikservo.view.session.gestures import Gestures
from ikservo.view.session.pilot import Pilot
from ikservo.view.session.ritual_words import shown_talk
from ikservo.view.session.status import banner, health, joint_meters, messages, mode

__all__ = ["arm_told", "status_told"]


def arm_told(pilot: Pilot, gestures: Gestures, right: Right, views: Sequence[ViewName]) -> Frame:
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


def status_told(
    pilot: Pilot, gestures: Gestures, step: int, controller: str, insight: Insight | None = None
) -> Frame:
    """Return everything that the page says beside the drawing.

    Args:
        pilot: Whose readout it is.
        gestures: What the person in control is doing.
        step: Which step of a lesson is shown.
        controller: Who has control: ``you``, ``other`` or ``none``.
        insight: What is known of the arm where it rests; None while it moves.
    """
    readout, live, lesson = pilot.readout, pilot.wish.live, gestures.lesson
    return {
        "kind": "status",
        "mode": mode(readout, live=live),
        "live": live,
        "controller": controller,
        "speed": pilot.wish.speed,
        "banner": banner(readout),
        "joints": joint_meters(pilot.arm.model, readout, gestures.goal),
        "health": health(readout.states, pilot.arm.model.health),
        "tip": _tip(pilot, gestures),
        "posture": insight_rows(pilot.arm.chain, _q(pilot), insight),
        "under": under_rows(gestures.under, gestures.chosen),
        "solver": {
            "name": gestures.solver,
            "time": "" if gestures.solve_s is None else solver_words(gestures.solve_s),
            "words": gestures.solver_words if lesson is None else lesson.words(step),
        },
        "preference": gestures.preference.told(gestures.solver),
        "messages": messages(readout, gestures.complaints),
        "calibration": shown_talk(pilot.arm.model, readout.talk) if readout.talk else None,
    }


def _tip(pilot: Pilot, gestures: Gestures) -> list[tuple[str, str, str]]:
    aim = gestures.aim
    rows = [("tip", point(_tip_m(pilot)), "")]
    if aim is not None:
        rows.append(("target", point(aim.target_m), "good" if aim.reached else "bad"))
        if not aim.reached:
            rows.append(("nearest", f"{point(aim.nearest_m)}, {aim.gap_m * 1000:.0f} mm", ""))
    return rows


def _q(pilot: Pilot) -> Vector:
    """Return the measured joints of the chain (dof,)."""
    names = [state.name for state in pilot.readout.states]
    return pilot.readout.measured[[names.index(name) for name in pilot.arm.chain.names]]


def _tip_m(pilot: Pilot) -> Vector:
    """Return where the tip is measured to be (3,)."""
    return pilot.arm.chain.forward(_q(pilot))[:3, 3]
