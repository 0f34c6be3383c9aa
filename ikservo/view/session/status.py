"""Everything the page says in words: modes, joints, health, messages."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ikservo.arm import JointState
from ikservo.calibration import say
from ikservo.kinematics.se3 import Vector
from ikservo.model import Model
from ikservo.model.health import HealthLimits
from ikservo.model.joint_limits import at_limit, near_limit
from ikservo.view.scene.texts import health_rows, supply_words
from ikservo.view.session.readout import Readout

__all__ = ["banner", "health", "joint_meters", "messages", "mode"]

_MOST_MESSAGES = 12


def mode(readout: Readout, *, live: bool) -> str:
    """Return what the arm does: ``calibration``, ``stopped``, ``live`` or ``preview``."""
    if readout.talk:
        return "calibration"
    if readout.trouble:
        return "stopped"
    return "live" if live else "preview"


def banner(readout: Readout) -> dict[str, str] | None:
    """Return why the arm holds until somebody has looked."""
    trouble = readout.trouble
    return None if trouble is None else {"message": trouble.message, "hint": trouble.hint}


def messages(readout: Readout, said: Sequence[str]) -> list[dict[str, str]]:
    """Return the latest notes of the arm, and what became of the target."""
    return [
        {"message": words, "hint": "", "level": ""}
        for words in (*readout.notes, *said)[-_MOST_MESSAGES:]
    ]


def joint_meters(model: Model, readout: Readout, goal: Vector | None) -> list[dict[str, object]]:
    """Return a meter for each joint: its calibrated range, where it is and where it is sent."""
    wanted = readout.measured if goal is None else goal
    rows = zip(readout.states, readout.measured, wanted, strict=True)
    return [_meter(model, state, float(at), float(to)) for state, at, to in rows]


def health(states: Sequence[JointState], limits: HealthLimits) -> dict[str, object]:
    """Return how the servos are."""
    volts = [state.voltage_v for state in states]
    return {"supply": supply_words(volts) if volts else "", "joints": health_rows(states, limits)}


def _meter(model: Model, state: JointState, at: float, to: float) -> dict[str, object]:
    unit = model.joint(state.name).joint_map.unit
    low, high = state.lower_rad, state.upper_rad
    at_it, near_it = (check(at, low, high, unit) for check in (at_limit, near_limit))
    if not math.isfinite(high - low):
        low, high = at - math.pi, at + math.pi

    def share(position: float) -> float:
        return round(float(np.clip((position - low) / max(high - low, 1e-9), 0.0, 1.0)), 4)

    return {
        "name": state.name,
        "text": say(at, unit),
        "low": say(low, unit),
        "high": say(high, unit),
        "from": state.limit_from,
        "share": share(at),
        "goal": share(to),
        "state": "at" if at_it else "near" if near_it else "",
    }
