"""Whether the rest pose of an arm file lies inside what a calibration has swept."""

from __future__ import annotations

from ikservo.arm.own import calibrated_limits
from ikservo.calibration.filing.record import Calibration
from ikservo.model import Model

__all__ = ["rest_beyond"]


def rest_beyond(model: Model, calibration: Calibration) -> list[str]:
    """Return which joints of the rest pose lie outside their calibrated limits, in words.

    Raises:
        CalibrationError: A joint has no range left.
    """
    found: list[str] = []
    for own in calibration.joints:
        joint, at = model.joint(own.name), model.pose("rest").get(own.name)
        limits = calibrated_limits(calibration, own, joint)
        if at is None or limits.holds(at):
            continue
        limit = limits.upper if at > limits.upper.value else limits.lower
        say = joint.joint_map.say
        found.append(
            f"{own.name}: the rest pose is at {say(at)}, outside its limit of {say(limit.value)} "
            f"({limit.source}); the arm is lowered to the limit."
        )
    return found
