"""Opening an arm: the port, then who is on it, then the limits that hold for this very arm."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ikservo.arm.arm import Arm, OnExit
from ikservo.arm.line import open_line
from ikservo.arm.own import OwnArm, check_models, own_arm, serial_number_of
from ikservo.arm.streaming.servos import Servos
from ikservo.arm.trust import Zeros
from ikservo.errors import InputError
from ikservo.files.writing import FileWriteError
from ikservo.guard import Box, Fence, Space, Weight, sag_of
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.finding.crowds import refusing_crowds
from ikservo.hardware.finding.discovery import remember_port
from ikservo.hardware.finding.strangers import naming_strangers
from ikservo.hardware.keeping.backup import back_up_once
from ikservo.kinematics import Chain
from ikservo.model import Model, ModelJoint, load_model
from ikservo.model.sag import masses_of, yields_of
from ikservo.model.shell import body_with_jaws

__all__ = ["open_arm"]

# Goals may run ahead of the beat by what a busy machine delays it.
_SPEED_SLACK = 1.2


def open_arm(
    arm: str | Path | Model,
    port: str | None = None,
    *,
    on_exit: OnExit = "hold",
    collisions: bool = True,
    uncalibrated: bool = False,
) -> Arm:
    """Open an arm; nothing moves and no torque changes.

    Args:
        arm: A name in the catalogue, a path to an arm file, or a loaded model.
        port: A serial port, ``sim`` for the simulated bus, or None for the only adapter.
        on_exit: What ``close`` does: ``hold`` leaves torque as it is, ``relax`` lowers the arm
            to its rest pose and releases it.
        collisions: Whether the way of the body is looked at before it moves: the arm against
            itself, the table and the boxes of its arm file.
        uncalibrated: Whether the person vouches that the horns are mounted as the arm file
            says, so that an arm without a calibration moves freely.

    Raises:
        UnknownNameError: No such arm.
        NoPortError: No such port, or none to choose.
        PortBusyError: Another process holds the port.
        ServoSilentError: A servo does not answer; names all that do not, and who is there instead.
        BadReplyError: Two servos answer to one id.
        CalibrationError: A servo is of another model than the arm file says, or holds other
            numbers than when the arm was calibrated; says which.
        FileFormatError: The arm's calibration is spoiled.
    """
    model = arm if isinstance(arm, Model) else load_model(arm)
    bus = open_line(model, port)
    line = bus.port
    try:
        with refusing_crowds(bus):
            with naming_strangers(bus):
                check_models(bus)
            remember_port(model.name, line.name)
            bus.learn_return_delays()
            own = own_arm(bus, model, uncalibrated=uncalibrated)
            _keep_copies(bus, model, own)
        fences = [_fence(own, model, joint) for joint in model.joints]
        shadows = {joint.name: [servo.id for servo in joint.shadows] for joint in model.joints}
        jaws = model.gripper.joint if model.gripper else None
        servos = Servos(bus, fences, shadows, line.clock, model.health, jaws)
        space = _space(model) if collisions else None
        chain = _narrowed(own.chain(), fences)
        machine = Arm(model, chain, servos, line, on_exit, space, own.zeros)
        machine.listen()
        return machine
    except BaseException:
        line.close()
        raise


def _keep_copies(bus: ServoBus, model: Model, own: OwnArm) -> None:
    """Copy every servo's EEPROM to a file at the first contact, where there is a file to write."""
    if own.zeros is not Zeros.SIMULATED:
        with contextlib.suppress(FileWriteError):
            back_up_once(bus, f"{model.name}-{serial_number_of(bus.port.name)}")


def _fence(own: OwnArm, model: Model, joint: ModelJoint) -> Fence:
    joint_map = own.joint_map(joint)
    horn_rad_s = max(speed.rad_s for speed in model.speeds.values())
    speed = horn_rad_s * joint.travel_per_turn / math.tau
    return Fence(joint_map, own.limits(joint, joint_map), speed * _SPEED_SLACK)


def _space(model: Model) -> Space:
    boxes = [Box(box.name, np.array(box.low_m), np.array(box.high_m)) for box in model.keep_out]
    body = body_with_jaws(model)
    chain = body.chain
    weight = Weight(
        masses_of(model, chain), yields_of(model, chain), chain.lower_rad, chain.upper_rad
    )
    return Space(body, model.floor_m, boxes, sag_of(body, weight))


def _narrowed(chain: Chain, fences: Sequence[Fence]) -> Chain:
    """Return the chain inside the fences, so that every solution is a goal that passes."""
    by_joint: Mapping[str, Fence] = {fence.joint: fence for fence in fences}
    missing = [name for name in chain.names if name not in by_joint]
    if missing:
        raise InputError(
            f"No servo is assigned to {', '.join(missing)}.",
            "Every joint up to the tip needs a [[joints]] table.",
        )
    ranges = [by_joint[name].positions for name in chain.names]
    return chain.with_limits([low for low, _ in ranges], [high for _, high in ranges])
