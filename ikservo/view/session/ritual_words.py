"""A calibration as the page shows it: the task in words, and a meter for each joint."""

from __future__ import annotations

from ikservo.arm.calibrating.sketch import sketch
from ikservo.arm.calibrating.steps import step_of
from ikservo.calibration.sweeping.meter import Meter, State, meters
from ikservo.calibration.sweeping.obstacles import findings
from ikservo.calibration.sweeping.sweep import Stage, Wizard
from ikservo.model import Model
from ikservo.view.session.readout import Talk
from ikservo.view.session.ritual import POSE

__all__ = ["shown_talk"]

_MAY = {Stage.ANCHOR: ("accept", "leave"), Stage.REVIEW: ("accept", "protect", "undo", "leave")}
_LET_GO = "Torque will be switched off; support the arm, then go on."


def shown_talk(model: Model, talk: Talk, pose: str = POSE) -> dict[str, object]:
    """Return a conversation that began in a pose as the page draws it."""
    wizard = talk.wizard
    stage = Stage.ANCHOR if wizard is None else wizard.stage
    swept = wizard is not None and stage in (Stage.SWEEP, Stage.REVIEW)
    return {
        "stage": stage.value,
        "task": _LET_GO if wizard is None else _task(model, wizard, pose),
        "sketch": "\n".join(_pictured(model)) if stage is Stage.ANCHOR else "",
        "lines": _lines(talk),
        "meters": [_meter(wizard, meter) for meter in meters(wizard)] if wizard and swept else [],
        "complaint": talk.complaint,
        "may": _MAY.get(stage, ("accept", "undo", "leave")),
    }


def _task(model: Model, wizard: Wizard, pose: str) -> str:
    if wizard.stage is Stage.ANCHOR:
        state = "It is held still." if wizard.still else "It still moves …"
        return f"Put the arm in the pose “{pose}” and hold it. {state}"
    if wizard.asked:
        return step_of(model, pose, wizard).request
    if wizard.stage is Stage.SWEEP:
        return "Now move every joint gently to both of its ends."
    return "Are these the ranges of the arm?" if wizard.stage is Stage.REVIEW else "Saved."


def _lines(talk: Talk) -> list[str]:
    if talk.wizard is None:
        return []
    if talk.wizard.stage is Stage.REVIEW:
        return [*findings(talk.wizard), *talk.warnings]
    return [talk.saved_at] if talk.saved_at else []


def _pictured(model: Model) -> list[str]:
    return sketch(model, model.joints[-1].name)[:-1]


def _meter(wizard: Wizard, meter: Meter) -> dict[str, object]:
    expected = meter.subject.expected
    low, high = expected.lower.value, expected.upper.value
    say = meter.subject.joint_map.say

    def share(position: float) -> float:
        return round(min(1.0, max(0.0, (position - low) / (high - low))), 3)

    moved = meter.state is not State.UNMOVED
    return {
        "name": meter.name,
        "asked": wizard.asked is meter.subject,
        "state": meter.state.value,
        "share": share(meter.position),
        "swept": [share(meter.low), share(meter.high)],
        "text": f"{say(meter.low)} … {say(meter.high)}" if moved else "",
    }
