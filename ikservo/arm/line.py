"""From an arm file to the servos on a port, before anything is asked of them."""

from __future__ import annotations

from ikservo.arm.given import port_name
from ikservo.errors import InputError
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.finding.discovery import choose_port, with_arm
from ikservo.hardware.line.port import open_port
from ikservo.hardware.servo import ServoSpec
from ikservo.model import Model, ModelServo
from ikservo.registers import table_for

__all__ = ["chosen_port", "open_line", "servo_specs"]


def open_line(model: Model, port: str | None = None, *, retries: int = 2) -> ServoBus:
    """Open the port of an arm's servos; none of them is asked anything yet.

    Args:
        model: The arm.
        port: See ``choose_port``.
        retries: How often a question is put again whose answer is lost.

    Raises:
        InputError: The model names no servos.
        PortError: No such port, none to choose, or it cannot be opened.
    """
    specs = servo_specs(model)
    return ServoBus(open_port(chosen_port(model, port), model.baud_rate), specs, retries=retries)


def chosen_port(model: Model, port: str | None) -> str:
    """Return the port's name as the transport wants it.

    Raises:
        NoPortError: There is none to choose.
        BadValueError: What is given is no name.
    """
    return with_arm(choose_port(port_name(port), model.name), model.path)


def servo_specs(model: Model) -> list[ServoSpec]:
    """Return every servo of an arm, shadows behind the servo they follow.

    Raises:
        InputError: The model names no servos.
    """
    if not model.joints:
        raise InputError(
            f"{model.path} has no servos.",
            "To move an arm, describe its servos in an arm.toml and give that to --arm.",
        )
    return [
        _spec(servo, joint.name)
        for joint in model.joints
        for servo in (joint.servo, *joint.shadows)
    ]


def _spec(servo: ModelServo, joint: str) -> ServoSpec:
    return ServoSpec(servo.id, table_for(servo.model), joint)
