"""Which arm is meant: the arm file of ``--arm``, and what is known of the arm that a person has."""

from __future__ import annotations

from ikservo.calibration import say, source_words
from ikservo.calibration.filing.store import calibrations_of
from ikservo.cli.output import note
from ikservo.errors import InputError
from ikservo.ik import Binding
from ikservo.kinematics.se3 import Vector
from ikservo.model import Model, arm_names, load_model

__all__ = ["chosen_model", "known_model", "limit_sources", "limit_words", "start_of"]

_ARM_FILE = "arm file"


def chosen_model(arm: str | None, tip: str | None = None) -> Model:
    """Return the model of ``--arm``, as its arm file has it.

    Raises:
        InputError: No arm was chosen; lists them.
    """
    if not arm:
        known = ", ".join(arm_names())
        raise InputError("No arm given.", f"Add --arm or set IKSERVO_ARM. Known: {known}.")
    return load_model(arm, tip)


def known_model(arm: str | None, tip: str | None = None) -> Model:
    """Return the model of ``--arm`` inside this arm's own calibration, where it has one; say so.

    Raises:
        InputError: No arm was chosen; lists them.
        FileFormatError: Its calibration is spoiled.
        CalibrationError: Its calibration is of another arm.
    """
    model = chosen_model(arm, tip)
    if not (model.joints and calibrations_of(model.name)):
        return model
    from ikservo.arm.known import known  # noqa: PLC0415  # brings the servos' rooms along

    own = known(model)
    more = f" (the newest; {len(own.others)} older beside it)" if own.others else ""
    note(f"Limits from calibration: {own.file}{more}")
    return own.model


def start_of(model: Model) -> Vector:
    """Return joints (dof,) inside the limits to start from: home, or the middle of the ranges."""
    chain = model.chain
    return chain.clip(model.chain_pose("home")) if "home" in model.poses else chain.middle()


def limit_words(model: Model, binding: Binding) -> str:
    """Return a limit that holds the arm back: ``j2 at its lower limit, 5.0° (arm file)``."""
    joint = next((joint for joint in model.joints if joint.name == binding.joint), None)
    if joint is None:
        return str(binding)
    limit = joint.limits.lower if binding.side == "lower" else joint.limits.upper
    return f"{binding}, {say(limit.value, joint.limits.unit)} ({source_words(limit.source)})"


def limit_sources(model: Model) -> list[str]:
    """Return where the range of each joint of the chain comes from (dof,)."""
    sources = {joint.name: joint.limits.source for joint in model.joints}
    return [sources.get(name, _ARM_FILE) for name in model.chain.names]
