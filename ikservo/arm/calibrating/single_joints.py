"""Some joints of a calibrated arm are calibrated again; the others keep what the file says."""

from __future__ import annotations

from collections.abc import Collection, Iterator

from ikservo.arm.calibrating.belonging import check_belongs
from ikservo.arm.calibrating.by_hand import LooseArm
from ikservo.arm.calibrating.filing import own_calibration
from ikservo.calibration.filing.record import CalibratedJoint, Calibration
from ikservo.calibration.in_servos.compare import contradictions_with, refuse
from ikservo.calibration.sweeping.outcome import Outcome

__all__ = ["base_calibration", "merged", "replaced_zeros"]

_USER_KEYS = ("user_lower_deg", "user_upper_deg", "user_lower_m", "user_upper_m")


def base_calibration(loose: LooseArm, joints: Collection[str]) -> Calibration:
    """Return the calibration of which some joints are to be replaced.

    Raises:
        CalibrationError: There is none, it is another arm's, or the servos of the joints that
            are kept contradict it.
        FileFormatError: It is damaged.
    """
    calibration = own_calibration(loose)
    check_belongs(calibration, loose.model, loose.serial_number)
    kept = tuple(joint for joint in calibration.joints if joint.name not in joints)
    refuse(contradictions_with(calibration.model_copy(update={"joints": kept}), loose.facts))
    return calibration


def merged(base: Calibration, outcome: Outcome) -> Outcome:
    """Return an outcome of some joints completed by the other joints of a calibration.

    Geometry found by a touch-off stays, as do ranges that the person has set.
    """
    new = {joint.name: joint for joint in outcome.calibration.joints}
    joints = tuple(
        _with_user_range(new[old.name], old) if old.name in new else old for old in base.joints
    )
    update = {"joints": joints, "geometry": base.geometry}
    return Outcome(outcome.calibration.model_copy(update=update), outcome.memory)


def replaced_zeros(base: Calibration, joints: Collection[str]) -> Iterator[str]:
    """Yield what of a touch-off is lost by calibrating some joints again, one line each."""
    if base.geometry:
        yield (
            f"Zeros from the touch-off of {base.geometry.touched:%Y-%m-%d} are replaced for "
            f"{', '.join(joints)}. Touch off again: ikservo calibrate {base.arm} --touch"
        )


def _with_user_range(new: CalibratedJoint, old: CalibratedJoint) -> CalibratedJoint:
    if new.user_range() != (None, None):
        return new
    return new.model_copy(update={key: getattr(old, key) for key in _USER_KEYS})
