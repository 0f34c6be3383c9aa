"""Whether a calibration file is of the arm that an arm file describes."""

from __future__ import annotations

from ikservo.calibration.filing.record import CalibratedJoint, Calibration
from ikservo.calibration.filing.store import calibration_path
from ikservo.errors import CalibrationError
from ikservo.model import Model, ModelJoint

__all__ = ["check_belongs", "check_joints"]


def check_belongs(calibration: Calibration, model: Model, usb_serial_number: str) -> None:
    """Compare a calibration with the arm file and the adapter.

    Raises:
        CalibrationError: It is another arm's, or the arm file has changed since.
    """
    path = calibration_path(model.name, usb_serial_number)
    own = (calibration.arm, calibration.usb_serial_number)
    if own != (model.name, usb_serial_number):
        raise CalibrationError(
            f"{path} belongs to {own[0]} on adapter {own[1] or 'without a number'}.",
            "If it is the same arm: ikservo calibration adopt. Otherwise: ikservo calibrate",
        )
    check_joints(calibration, model, str(path))


def check_joints(calibration: Calibration, model: Model, path: str) -> None:
    """Compare the joints of a calibration with the arm file's.

    Raises:
        CalibrationError: The arm file has other servos or another chain.
    """
    filed = {joint.name: _filed(joint) for joint in calibration.joints}
    wanted = {joint.name: _wanted(joint) for joint in model.joints}
    for name in filed.keys() | wanted.keys():
        if filed.get(name) != wanted.get(name):
            raise CalibrationError(
                f"{name} is {filed.get(name, 'unknown')} in {path} and "
                f"{wanted.get(name, 'unknown')} in the arm file.",
                "Choose the right arm with --arm, or calibrate again: ikservo calibrate",
            )
    _check_origins(calibration, model)


def _check_origins(calibration: Calibration, model: Model) -> None:
    known = {step.joint.name for step in model.chain.way()}
    for origin in calibration.geometry.origins if calibration.geometry else ():
        if origin.joint not in known:
            raise CalibrationError(
                f"The touch-off moved {origin.joint}, which is not between base and tip.",
                "The arm file has changed since. Repeat the touch-off: ikservo calibrate --touch",
            )


def _filed(joint: CalibratedJoint) -> str:
    return _said([(servo.id, servo.model) for servo in joint.servos], joint.gear)


def _wanted(joint: ModelJoint) -> str:
    servos = [(servo.id, servo.model) for servo in (joint.servo, *joint.shadows)]
    return _said(servos, joint.joint_map.gear)


def _said(servos: list[tuple[int, str]], gear: float) -> str:
    """Return servos as a person reads them: ``XM430-W350 (id 2)``."""
    listed = " and ".join(f"{model} (id {servo_id})" for servo_id, model in servos)
    return listed if abs(gear - 1.0) < 1e-9 else f"{listed} with gear {gear:.6g}"
