"""The numbered steps of a calibration by hand, with the request of each as text.

Step 1 is the pose, then comes one step for each joint's direction, then the sweep, then the
review. A skipped joint leaves a gap, so that the numbers do not change.
"""

from __future__ import annotations

from dataclasses import dataclass

from ikservo.calibration.procedure import CalibrationStage, CalibrationState
from ikservo.calibration.range_tracker import JointUnderCalibration
from ikservo.model import Model
from ikservo.model.tool import describe_direction

__all__ = ["CalibrationStep", "current_step"]


@dataclass(frozen=True, slots=True)
class CalibrationStep:
    """One step of a calibration.

    Attributes:
        number: From 1.
        count: How many steps there are.
        request: What the user is to do.
    """

    number: int
    count: int
    request: str

    def __str__(self) -> str:
        return f"Step {self.number} of {self.count}: {self.request}"


def current_step(model: Model, pose: str, state: CalibrationState) -> CalibrationStep:
    """Return the step that a calibration from a named pose is at."""
    count = len(state.subjects) + 3
    if state.stage is CalibrationStage.REFERENCE_POSE:
        return CalibrationStep(1, count, _pose_request(model, pose, state))
    if state.current_joint:
        number = [subject.name for subject in state.subjects].index(state.current_joint.name) + 2
        return CalibrationStep(
            number, count, _direction_request(model, pose, state, state.current_joint)
        )
    if state.stage is CalibrationStage.SWEEP:
        return CalibrationStep(
            count - 1, count, f"Move {_describe_moved(model, state)} gently to both end stops."
        )
    return CalibrationStep(count, count, "Review and save.")


def _pose_request(model: Model, pose: str, state: CalibrationState) -> str:
    what = f'Put the arm in the pose "{pose}"'
    if len(state.subjects) < len(model.joints):
        positions = [f"{s.name} at {s.joint_map.format(s.pose)}" for s in state.subjects]
        what = f'Put {", ".join(positions)} (pose "{pose}")'
    return f"{what}: {'held still, press Enter.' if state.is_at_rest else 'hold it still …'}"


def _direction_request(
    model: Model, pose: str, state: CalibrationState, subject: JointUnderCalibration
) -> str:
    direction = describe_direction(model, model.joint(subject.name), pose, subject.free_direction)
    if not state.is_second_trial:
        return f"Move {subject.name} {direction}."
    if state.returned:
        return f"Move {subject.name} again {direction}."
    return (
        f"{subject.name}: sign is opposite to the arm file. Was it first moved the wrong way? "
        "Move it back to where it was."
    )


def _describe_moved(model: Model, state: CalibrationState) -> str:
    if len(state.subjects) < len(model.joints):
        return ", ".join(subject.name for subject in state.subjects)
    return "every joint"
