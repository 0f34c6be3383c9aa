"""The steps of a calibration by hand, numbered through, with the request of each in words.

Step 1 is the pose, then comes one step for each joint's direction, then the sweep, then the
review. A skipped joint leaves a gap, so that the numbers stay what they are.
"""

from __future__ import annotations

from dataclasses import dataclass

from ikservo.calibration.sweeping.subject import Subject
from ikservo.calibration.sweeping.sweep import Stage, Wizard
from ikservo.model import Model
from ikservo.model.directions import direction

__all__ = ["Step", "step_of"]


@dataclass(frozen=True, slots=True)
class Step:
    """One step of a calibration.

    Attributes:
        number: From 1.
        count: How many steps there are.
        request: What the person is to do.
    """

    number: int
    count: int
    request: str

    def __str__(self) -> str:
        return f"Step {self.number} of {self.count}: {self.request}"


def step_of(model: Model, pose: str, wizard: Wizard) -> Step:
    """Return the step that a calibration from a named pose is at."""
    count = len(wizard.subjects) + 3
    if wizard.stage is Stage.ANCHOR:
        return Step(1, count, _pose_request(model, pose, wizard))
    if wizard.asked:
        place = [subject.name for subject in wizard.subjects].index(wizard.asked.name)
        return Step(place + 2, count, _direction_request(model, pose, wizard, wizard.asked))
    if wizard.stage is Stage.SWEEP:
        return Step(count - 1, count, f"Move {_moved(model, wizard)} gently to both end stops.")
    return Step(count, count, "Review and save.")


def _pose_request(model: Model, pose: str, wizard: Wizard) -> str:
    what = f'Put the arm in the pose "{pose}"'
    if len(wizard.subjects) < len(model.joints):
        places = [f"{s.name} at {s.joint_map.say(s.pose)}" for s in wizard.subjects]
        what = f'Put {", ".join(places)} (pose "{pose}")'
    return f"{what}: {'held still, press Enter.' if wizard.still else 'hold it still …'}"


def _direction_request(model: Model, pose: str, wizard: Wizard, subject: Subject) -> str:
    way = direction(model, model.joint(subject.name), pose, subject.towards)
    if not wizard.repeated:
        return f"Move {subject.name} {way}."
    if wizard.returned:
        return f"Move {subject.name} again {way}."
    return (
        f"{subject.name}: sign is opposite to the arm file. Was it first moved the wrong way? "
        "Move it back to where it was."
    )


def _moved(model: Model, wizard: Wizard) -> str:
    if len(wizard.subjects) < len(model.joints):
        return ", ".join(subject.name for subject in wizard.subjects)
    return "every joint"
