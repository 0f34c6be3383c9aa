"""Which arm is meant: the arm file of ``--arm``, and what is known of the arm that a person has."""

from __future__ import annotations

from ikservo.calibration import format_position, source_words
from ikservo.calibration.calibration_file import calibrations_of
from ikservo.cli.terminal import print_status
from ikservo.errors import InputError
from ikservo.ik import ActiveLimit
from ikservo.kinematics.arrays import Vector
from ikservo.model import Model, arm_names, load_model

__all__ = [
    "calibrated_model_from_option",
    "describe_limit",
    "initial_joints",
    "limit_sources",
    "model_from_option",
]

_ARM_FILE = "arm file"


def model_from_option(arm: str | None, tip: str | None = None) -> Model:
    """Return the model of ``--arm``, as its arm file has it.

    Raises:
        InputError: No arm was chosen; lists them.
    """
    if not arm:
        known = ", ".join(arm_names())
        raise InputError("No arm given.", f"Add --arm or set IKSERVO_ARM. Known: {known}.")
    return load_model(arm, tip)


def calibrated_model_from_option(arm: str | None, tip: str | None = None) -> Model:
    """Return the model of ``--arm`` inside this arm's own calibration, where it has one; say so.

    Raises:
        InputError: No arm was chosen; lists them.
        FileFormatError: Its calibration is spoiled.
        CalibrationError: Its calibration is of another arm.
    """
    model = model_from_option(arm, tip)
    if not (model.joints and calibrations_of(model.name)):
        return model
    from ikservo.arm.calibrated_arm import calibrated_model  # noqa: PLC0415  # brings the servos' rooms along

    own = calibrated_model(model)
    more = f" (the newest; {len(own.others)} older beside it)" if own.others else ""
    print_status(f"Limits from calibration: {own.file}{more}")
    return own.model


def initial_joints(model: Model) -> Vector:
    """Return joints (dof,) inside the limits to start from: home, or the middle of the ranges."""
    chain = model.chain
    return chain.clip(model.chain_pose("home")) if "home" in model.poses else chain.mid_range()


def describe_limit(model: Model, binding: ActiveLimit) -> str:
    """Return a limit that holds the arm back: ``j2 at its lower limit, 5.0° (arm file)``."""
    joint = next((joint for joint in model.joints if joint.name == binding.joint), None)
    if joint is None:
        return str(binding)
    limit = joint.limits.lower if binding.side == "lower" else joint.limits.upper
    position = format_position(limit.value, joint.limits.unit)
    return f"{binding}, {position} ({source_words(limit.source)})"


def limit_sources(model: Model) -> list[str]:
    """Return where the range of each joint of the chain comes from (dof,)."""
    sources = {joint.name: joint.limits.source for joint in model.joints}
    return [sources.get(name, _ARM_FILE) for name in model.chain.names]
