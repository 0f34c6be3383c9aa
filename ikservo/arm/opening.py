"""Open an arm: serial port, servo check, calibration and joint limits."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ikservo.arguments import OnExit, parse_port
from ikservo.arm.arm import Arm
from ikservo.arm.arm_protocol import OpenArm
from ikservo.arm.motion_runner import MotionRunner
from ikservo.arm.stoppable_bus import stoppable
from ikservo.calibration.paths import identified_path
from ikservo.control.feed_forward import FeedForward
from ikservo.control.goal_compensation import GoalCompensator
from ikservo.control.servo_group import ServoGroup
from ikservo.errors import BusError, CalibrationError, InputError, RefusedError
from ikservo.files.writing import FileWriteError
from ikservo.guard import CollisionChecker, DrivenJoint
from ikservo.guard.sag import arm_sag
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.eeprom import back_up_once
from ikservo.hardware.port import open_port
from ikservo.hardware.port_choice import (
    choose_port,
    is_simulator,
    named_port,
    remember_port,
    simulated_port_url,
)
from ikservo.hardware.port_names import serial_number_of
from ikservo.hardware.servo import ServoSpec
from ikservo.hardware.torque import torque_off
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Matrix
from ikservo.model import Model, load_model
from ikservo.model.collision_capsules import collision_body, collision_body_with_gripper
from ikservo.model.joint_drive import nominal_parameters, stall_error
from ikservo.model.load_lag import LoadLag, load_lags
from ikservo.planning.calibrated_arm import (
    CalibratedArm,
    ZeroSource,
    check_servo_models,
    load_calibration_for,
)
from ikservo.planning.context import ArmContext
from ikservo.registers import control_table

if TYPE_CHECKING:
    from ikservo.arm.networks import ArmNetwork


def open_bus(model: Model, port: str | None = None, *, retries: int = 2) -> ServoBus:
    """Open the port of an arm's servos; nothing is sent yet.

    From then on, the user's other programs can stop this one. A request whose reply is lost is
    repeated ``retries`` times.

    Raises:
        InputError: The model names no servos.
        PortError: The port does not exist or cannot be opened, or there is no port to choose from.
    """
    specs = servo_specs(model)
    url, ids = resolve_port(model, port), [spec.id for spec in specs]
    opened_port = open_port(url, model.baud_rate, model.name, ids)
    bus = ServoBus(opened_port, specs, retries=retries)
    bus.backup_owner = backup_owner(opened_port.name, model.name)
    return stoppable(bus, model.name)


def backup_owner(port_name: str, arm: str = "") -> str:
    """Return the folder name for EEPROM backups of an arm or of servos; empty if simulated."""
    if is_simulator(port_name):
        return ""
    serial_number = serial_number_of(port_name)
    return f"{arm}-{serial_number}" if arm else serial_number or "servos"


def disable_torque_unchecked(model: Model, port: str | None) -> None:
    """Switch off the torque of an arm that cannot be opened, without checking models and zeros.

    Raises:
        PortError: The port cannot be opened.
        BusError: A servo does not reply; the torque of all others is off.
    """
    with open_bus(model, port) as bus:
        for error in torque_off(bus, bus.servos).values():
            raise error


def resolve_port(model: Model, port: str | None) -> str:
    """Return the port's name for the transport; ``sim`` becomes a simulated copy of the arm.

    Raises:
        NoPortError: There is no port to choose from.
        BadValueError: The value is not the name of a port.
    """
    name = choose_port(parse_port(port), model.name)
    if not is_simulator(name):
        return name
    return simulated_port_url(name, model.path.resolve())


def servo_specs(model: Model) -> list[ServoSpec]:
    """List every servo of an arm; a joint's first servo precedes its other servos.

    Raises:
        InputError: The model names no servos.
    """
    if not model.joints:
        raise InputError(
            f"{model.path} has no servos.",
            "To move an arm, describe its servos in an arm.toml and give that file to --arm.",
        )
    return [
        ServoSpec(servo.id, control_table(servo.model), joint.name)
        for joint in model.joints
        for servo in (joint.servo, *joint.shadows)
    ]


# After a cycle that a busy machine delays, the next step is longer.
_SPEED_MARGIN = 1.2


def open_arm(
    arm: str | Path | Model,
    port: str | None = None,
    *,
    on_exit: OnExit = "hold",
    collisions: bool = True,
    uncalibrated: bool = False,
) -> OpenArm:
    """Open an arm; nothing moves and no torque changes.

    On a port of this machine, the result is an ``Arm``.

    Args:
        arm: A name in the catalogue, a path to an arm file, or a loaded model.
        port: A serial port, ``sim`` for the simulated bus, ``zenoh:NAME@HOST`` for an arm that
            another machine serves, or None for the only adapter.
        on_exit: State after ``close``: ``hold`` leaves torque unchanged, ``relax`` lowers the arm
            to its rest pose and switches torque off.
        collisions: Whether paths are checked before the body moves: against the arm itself, the
            table and the boxes of its arm file.
        uncalibrated: Whether the user accepts the arm file's zeros, so that an arm without
            calibration can move freely.

    Raises:
        UnknownNameError: There is no such arm.
        NoPortError: There is no such port, or there is none to choose from.
        PortBusyError: Another process holds the port.
        ServoSilentError: Servos do not reply; they and unexpected servos are named.
        BadReplyError: Two servos have the same id.
        CalibrationError: A servo's model differs from the arm file, or registers have changed since
            the calibration; they are named.
        FileFormatError: The arm's calibration is malformed.
    """
    model = arm if isinstance(arm, Model) else load_model(arm)
    address = named_port(parse_port(port))
    if ":" in address and not is_simulator(address):
        from ikservo.arm.networks import find_network  # noqa: PLC0415  # slow, seldom needed

        network_address = find_network(address)
        if network_address is not None:
            return _open_remote(model, network_address, on_exit, collisions, uncalibrated)
    return open_own_arm(
        model, port, on_exit=on_exit, collisions=collisions, uncalibrated=uncalibrated
    )


def open_own_arm(
    model: Model,
    port: str | None = None,
    *,
    on_exit: OnExit = "hold",
    collisions: bool = True,
    uncalibrated: bool = False,
) -> Arm:
    """Open an arm on a port of this machine; see ``open_arm``.

    Raises:
        PortError: The arm is on another machine. The other errors are those of ``open_arm``.
    """
    bus = open_bus(model, port)
    opened_port = bus.port
    try:
        own = _read_calibrated_arm(bus, model, uncalibrated=uncalibrated)
        driven_joints = _make_limits(own, model)
        shadows = {joint.name: [servo.id for servo in joint.shadows] for joint in model.joints}
        gripper = model.gripper.joint if model.gripper else None
        servos = ServoGroup(bus, driven_joints, shadows, bus.port.clock, model.health, gripper)
        checker = make_collision_checker(model, own.chain()) if collisions else None
        chain = _narrow_chain(own.chain(), driven_joints)
        serial_number = serial_number_of(opened_port.name)
        servos.compensator = _make_compensator(own, model, chain, driven_joints, serial_number)
        context = ArmContext.build(model, chain, servos, opened_port, checker, own.zeros)
        opened = Arm(context, MotionRunner(context), on_exit)
        opened.listen()
        return opened
    except BaseException:
        bus.close()
        raise


def _read_calibrated_arm(bus: ServoBus, model: Model, *, uncalibrated: bool) -> CalibratedArm:
    """Check the servos on a bus and load their calibration; add explanations to errors."""
    try:
        check_servo_models(bus)
        remember_port(model.name, bus.port.name)
        bus.load_return_delays()
        own = load_calibration_for(bus, model, uncalibrated=uncalibrated)
        if own.zeros is not ZeroSource.SIMULATED:
            with contextlib.suppress(FileWriteError):  # opening does not depend on the backup
                back_up_once(bus, bus.backup_owner)
    except (BusError, CalibrationError) as error:
        from ikservo.hardware.duplicate_ids import raise_explained  # noqa: PLC0415  # a failure only

        raise_explained(bus, error)
        raise
    if bus.port.health.degraded:
        from ikservo.hardware.duplicate_ids import raise_on_duplicate_ids  # noqa: PLC0415

        raise_on_duplicate_ids(bus)
    return own


def require_own_port(arm: OpenArm) -> Arm:
    """Return an open arm as an ``Arm``, for code that needs the servos.

    Raises:
        RefusedError: The servos are on another machine.
    """
    if isinstance(arm, Arm):
        return arm
    raise RefusedError(
        f"This needs the servos' own port, which is not on this machine: {arm.port_name}",
        "Run this on that machine, with the port of the servos, after `ikservo serve` has ended.",
    )


def _open_remote(
    model: Model,
    network_address: tuple[ArmNetwork, str],
    on_exit: OnExit,
    collisions: bool,
    uncalibrated: bool,
) -> OpenArm:
    if uncalibrated or not collisions:
        option = "--uncalibrated" if uncalibrated else "--no-collision"
        raise InputError(
            f"{option} cannot be used for an arm on another machine.",
            f"Give it to the server on that machine: ikservo serve ... {option}",
        )
    from ikservo.model.scene_file import KeepOutShape  # noqa: PLC0415  # only for this check

    network, address = network_address
    if any(isinstance(each, KeepOutShape) for each in model.keep_out):
        raise InputError(
            "A scene cannot be given for an arm on another machine.",
            "Give the scene to the program that serves the arm there.",
        )
    return network.open_arm(model, address, on_exit)


def _make_limits(own: CalibratedArm, model: Model) -> list[DrivenJoint]:
    lags = load_lags(model, model.chain, model.payload_kg)
    horn_rad_s = max(speed.rad_s for speed in model.speeds.values())
    driven_joints: list[DrivenJoint] = []
    for joint in model.joints:
        joint_map, lag = own.joint_map(joint), lags.get(joint.name, LoadLag())
        limits = own.limits(joint, joint_map)
        speed = horn_rad_s * joint.travel_per_turn / math.tau * _SPEED_MARGIN
        stall = stall_error(joint, model.supply_v)
        driven = DrivenJoint(joint_map, limits, speed, stall, lag.lifting_rad, lag.sag_rad)
        driven_joints.append(driven)
    return driven_joints


def make_collision_checker(model: Model, own_chain: Chain | None = None) -> CollisionChecker:
    """Make the collision checker of an arm with its gripper, which allows for the arm's sag.

    The calibrated ``own_chain`` converts sensor readings to the actual angles of the links.
    """
    body = collision_body_with_gripper(model)
    checker = CollisionChecker(body, model.floor_m, model.keep_out, arm_sag(model, body))
    link_joints = None if own_chain is None else own_chain.link_joints
    if own_chain is not None and link_joints is not None:
        columns = [body.chain.names.index(name) for name in own_chain.names]

        def bend(q: Matrix) -> Matrix:
            bent = q.copy()
            bent[:, columns] = link_joints(q[:, columns])
            return bent

        checker.bends = bend
    return checker


def _make_compensator(
    own: CalibratedArm,
    model: Model,
    chain: Chain,
    driven_joints: Sequence[DrivenJoint],
    serial_number: str,
) -> GoalCompensator:
    """Make the goal compensator, with the masses of the links if the joint zeros are known.

    The masses were identified for this arm, or else come from the arm file.
    """
    names = [driven.joint for driven in driven_joints]
    columns = [names.index(name) for name in chain.names]
    if not own.zeros.are_known:
        return GoalCompensator(driven_joints, columns, None)
    identified = identified_path(model.name, serial_number)
    if identified.exists():
        from ikservo.calibration.identified_file import read_identified  # noqa: PLC0415
        from ikservo.model.identified_drives import identified_parameters  # noqa: PLC0415

        parameters = identified_parameters(model, chain, read_identified(identified))
    else:
        parameters = nominal_parameters(model, chain)
    feed_forward = None if parameters is None else FeedForward(parameters, columns)
    return GoalCompensator(driven_joints, columns, feed_forward)


def make_collision_filter(model: Model) -> Callable[[Matrix], NDArray[np.bool_]]:
    """Return a function that checks configurations (n, dof); its result (n,) is True if free."""
    return CollisionChecker(collision_body(model), model.floor_m, model.keep_out).collision_free


def _narrow_chain(chain: Chain, driven_joints: Sequence[DrivenJoint]) -> Chain:
    """Return the chain with the command limits, so that every solution is a valid goal."""
    by_joint: Mapping[str, DrivenJoint] = {driven.joint: driven for driven in driven_joints}
    missing = [name for name in chain.names if name not in by_joint]
    if missing:
        raise InputError(
            f"No servo is assigned to {', '.join(missing)}.",
            "Every joint up to the tip needs a [[joints]] table.",
        )
    ranges = [by_joint[name].position_range for name in chain.names]
    return chain.with_limits([low for low, _ in ranges], [high for _, high in ranges])
