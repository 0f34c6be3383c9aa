"""Assemble a bus: servos on the joints of an arm, or on a bench without an arm."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

from servosim.arm_file import JointEntry, ServoEntry, SimulatedArmFile
from servosim.dynamics import FreeBody, RigidArm
from servosim.errors import ArmFileError, SimulatorError
from servosim.family import FamilyMember
from servosim.feetech import Feetech
from servosim.joint import SimulatedJoint
from servosim.motor import Motor
from servosim.parameters import PARAMETERS, MotorParameters, in_an_arm
from servosim.register import ServoTable, SimulatedFamily
from servosim.servo import HornMounting, Servo
from servosim.servo_models import baud_code, make_servo, table_for
from servosim.specimen import Specimen
from servosim.surroundings import Cube, Surroundings
from servosim.world import ExternalDynamics, PowerSupply, World

STOP_MARGIN_RAD = math.radians(2.0)  # distance of hard stops beyond the URDF's limits
STOP_MARGIN_M = 0.0005
MAX_PLAY_DEG = 10.0


@dataclass(frozen=True, slots=True)
class BenchServo:
    """A servo without an arm.

    Attributes:
        id: The id on the bus.
        model: The model in the datasheet.
        baud: The baud rate; None uses the common rate.
    """

    id: int
    model: str
    baud: int | None = None


def make_arm_world(
    arm: SimulatedArmFile,
    pose: str = "rest",
    seed: int | None = None,
    *,
    physics: bool = False,
    backlash_deg: float | None = None,
    specimen: Specimen | None = None,
    cubes: tuple[Cube, ...] = (),
    has_board: bool = True,
) -> World:
    """Make an arm in a pose, torque off, its servos with factory settings.

    Args:
        arm: The arm.
        pose: The start pose.
        seed: The seed of one arm of the family (`family.FAMILY`); None for the nominal arm.
        physics: True for bodies and contacts from MuJoCo, with the masses of the URDF.
        backlash_deg: Backlash of every servo's gears; None uses the backlash of the arm.
        specimen: Masses, payload and motors that differ from those of the files.
        cubes: Cubes on the table, with ``physics`` only.
        has_board: Whether a simulated camera sees a board on the tip.

    Raises:
        ArmFileError: There is no such pose, or the URDF lacks a joint or the tip.
        SimulatorError: MuJoCo is not installed, the backlash is out of range, other masses are
            given with MuJoCo, cubes without it, or a payload without a tip.
        UnknownModelError: A servo model has no table.
    """
    if pose not in arm.poses:
        raise ArmFileError(arm.path, f"poses.{pose}", f"no such pose; has: {', '.join(arm.poses)}")
    if backlash_deg is not None and not 0.0 <= backlash_deg <= MAX_PLAY_DEG:
        raise SimulatorError(f"the backlash is 0 to {MAX_PLAY_DEG:g}°, not {backlash_deg}°")
    if cubes and not physics:
        raise SimulatorError("cubes need MuJoCo; add physics=1")
    specimen = specimen or Specimen()
    if physics and specimen.changes_masses:
        raise SimulatorError("MuJoCo uses the masses of the URDF, without a payload")
    if physics and arm.base:
        raise SimulatorError("MuJoCo places the base as the URDF does; change its pose there")
    names = [joint.name for joint in arm.joints]
    member = None if seed is None else FamilyMember(seed)
    if member is not None and not physics:
        drawn = {name: member.drawn("mass", name) for name in names}
        specimen = replace(specimen, mass_scales={**drawn, **specimen.mass_scales})
    body = RigidArm(arm.urdf, names, specimen, arm.tip, arm.base)
    build = _ServoBuild(arm, member, backlash_deg, specimen)
    joints = [
        _make_joint(build, entry, arm.poses[pose].get(entry.name, 0.0), entry.limits or limits)
        for entry, limits in zip(arm.joints, body.limits, strict=True)
    ]
    tip = body.tip(arm.tip) if arm.tip else None
    rails = None if member is None else _weak_rails(joints, member.drawn("supply"))
    around = Surroundings(arm, cubes, has_board)
    facing = arm.poses.get("home", arm.poses[pose])
    home = [facing.get(name, 0.0) for name in names]
    if physics:
        mover = _make_mujoco_body(arm, joints, cubes)
        return World(joints, mover, rails, tip=tip, surroundings=around, home=home)
    others = [positions for name, positions in arm.poses.items() if name != "rest"]
    postures = [[positions.get(name, 0.0) for name in names] for positions in others]
    contacts = body.contacts(arm.floor_m, postures)
    return World(joints, body, rails, contacts, tip, around, home)


def _weak_rails(joints: Iterable[SimulatedJoint], share: float) -> dict[float, PowerSupply]:
    volts = {servo.motor.parameters.nominal_v for joint in joints for servo in joint.servos}
    return {volt: PowerSupply(share * volt) for volt in volts}


def _make_mujoco_body(
    arm: SimulatedArmFile, joints: list[SimulatedJoint], cubes: tuple[Cube, ...]
) -> ExternalDynamics:
    try:
        from servosim.mujoco_body import MujocoBody  # noqa: PLC0415 - an extra, and slow to import
    except ImportError as error:
        raise SimulatorError("MuJoCo is not installed; it needs the extra physics") from error
    motors = [[servo.motor.parameters for servo in joint.servos] for joint in joints]
    margins = [_stop_margin(joint.is_prismatic) for joint in joints]
    names = [joint.name for joint in joints]
    return MujocoBody(arm.urdf, names, motors, arm.floor_m, margins, cubes)


def _stop_margin(slides: bool) -> float:
    return STOP_MARGIN_M if slides else STOP_MARGIN_RAD


def make_bench_world(
    servos: Iterable[BenchServo],
    baud: int | None = None,
    seed: int = 0,
    protocol: int | None = None,
) -> World:
    """Make servos on a bench, which move no arm.

    Args:
        servos: The servos.
        baud: The rate of servos that have no rate of their own; None for the factory default.
        seed: The seed of their tolerances.
        protocol: 1 or 2 for Dynamixel X servos; None for the factory default.

    Raises:
        SimulatorError: A servo does not support the rate or the protocol.
        UnknownModelError: A servo model has no table.
    """
    joints: list[SimulatedJoint] = []
    for place, bench in enumerate(servos, start=1):
        table = table_for(bench.model)
        rate = bench.baud or baud
        delivered = {"id": bench.id} | ({} if rate is None else _baud_registers(table, rate))
        delivered |= _protocol_registers(table, protocol)
        shaft = HornMounting(1, table.middle_tick, table.ticks_per_turn)
        half_rad = table.travel_rad / 2.0
        motor = Motor(PARAMETERS[table.model], 0.0, -half_rad, half_rad)
        servo = make_servo(table.model, motor, shaft, delivered, seed + place)
        joints.append(SimulatedJoint(f"servo_{place}", (servo,)))
    return World(joints, FreeBody([joint.name for joint in joints]))


@dataclass(frozen=True, slots=True)
class _ServoBuild:
    """Data from which the servos of an arm are built."""

    arm: SimulatedArmFile
    member: FamilyMember | None
    backlash_deg: float | None
    specimen: Specimen

    def parameters(self, joint: str, model: str) -> MotorParameters:
        """Return the motor of a servo on a joint."""
        nominal = PARAMETERS[model]
        if self.member is None:
            own = in_an_arm(nominal)
        else:
            own = self.member.motor_parameters(joint, nominal)
        if self.backlash_deg is not None:
            own = replace(own, backlash_rad=math.radians(self.backlash_deg))
        return self.specimen.motor_parameters(joint, own)


def _make_joint(
    build: _ServoBuild, entry: JointEntry, position: float, limits: tuple[float, float]
) -> SimulatedJoint:
    transmission = entry.servos[0].transmission
    margin = _stop_margin(transmission.is_prismatic)
    horn_rad = transmission.horn_rad(position)
    stops = sorted(transmission.horn_rad(end) for end in (limits[0] - margin, limits[1] + margin))
    servos = tuple(_make_servo(build, entry.name, servo, horn_rad, stops) for servo in entry.servos)
    return SimulatedJoint(entry.name, servos, transmission)


def _make_servo(
    build: _ServoBuild, joint: str, entry: ServoEntry, angle_rad: float, stops: list[float]
) -> Servo:
    arm = build.arm
    table = table_for(_model_at(arm, entry.model))
    unknown = [name for name in entry.eeprom if name not in table.by_name]
    if unknown:
        raise ArmFileError(arm.path, f"servo {entry.id}", f"no register named {unknown[0]!r}")
    delivered = {**entry.eeprom, **_baud_registers(table, arm.baud), "id": entry.id}
    motor = Motor(build.parameters(joint, table.model), angle_rad, *stops)
    shaft = HornMounting(entry.sign, entry.zero_tick, table.ticks_per_turn)
    member = build.member
    servo = make_servo(
        table.model, motor, shaft, delivered, entry.id + (member.seed if member else 0)
    )
    if isinstance(servo, Feetech) and member is not None and not member.d_gain_acts:
        servo.kd_per_gain = 0.0
        servo.set_gains()
    return servo


def _model_at(arm: SimulatedArmFile, model: str) -> str:
    """Return the variant of a model for the arm's supply voltage."""
    if arm.supply_v is None or PARAMETERS[table_for(model).model].nominal_v == arm.supply_v:
        return model
    for name, parameters in PARAMETERS.items():
        if name.startswith(f"{model}-") and parameters.nominal_v == arm.supply_v:
            return name
    raise ArmFileError(arm.path, "bus.supply_v", f"there is no {model} for {arm.supply_v:g} V")


def _protocol_registers(table: ServoTable, protocol: int | None) -> dict[str, int]:
    default_protocol = {
        SimulatedFamily.DYNAMIXEL_X: 2,
        SimulatedFamily.DYNAMIXEL_320: 2,
        SimulatedFamily.DYNAMIXEL_1: 1,
    }.get(table.family)
    if protocol is None or protocol == default_protocol:
        return {}
    row = table.by_name.get("protocol_type")
    if row is None or not row.accepts(protocol):
        raise SimulatorError(f"{table.model} does not speak Dynamixel protocol {protocol}")
    return {"protocol_type": protocol}


def _baud_registers(table: ServoTable, baud: int) -> dict[str, int]:
    return {"baud_rate": baud_code(table.family, baud)}
