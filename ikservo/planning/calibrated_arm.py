"""The model of one particular arm: arm file and calibration, checked against the servos."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ikservo.calibration import JointMap, Limits
from ikservo.calibration.calibration_file import load_calibration, read_calibration
from ikservo.calibration.joint_map import Encoder, encoder_of, unwrap_near
from ikservo.calibration.paths import calibration_path, calibrations_of, journal_path
from ikservo.calibration.records import CalibratedGeometry, CalibratedJoint, Calibration
from ikservo.calibration.servo_config import (
    raise_on_mismatch,
    read_servo_config,
    register_mismatches,
)
from ikservo.control.joint_reading import read_register
from ikservo.errors import CalibrationError
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.port_names import is_simulated, serial_number_of
from ikservo.hardware.serial_ports import is_pseudo_terminal
from ikservo.kinematics import Chain, Dynamics
from ikservo.kinematics.arrays import Vector
from ikservo.model import Model, ModelJoint, load_model
from ikservo.model.arm_model import link_masses
from ikservo.registers import MODELS, RegisterName, control_table_for_number

if TYPE_CHECKING:
    from ikservo.kinematics.bending_and_backlash import Bending
    from ikservo.kinematics.geometric_errors import GeometricErrors

MAX_UNCALIBRATED_STEP_RAD = math.radians(10.0)
"""Longest single motion of an uncalibrated joint, as rotation of its horn [rad]."""

_HINT = (
    "Calibrate it: ikservo calibrate {arm}. Until then: ikservo joints, at most 10° at a time "
    "(or --uncalibrated, if the horns are mounted exactly as in the arm file)."
)


class ZeroSource(Enum):
    """The source of the zeros of an arm's joints."""

    CALIBRATED = "this arm's own"
    VENDOR = "the maker's"
    SIMULATED = "the simulator's"
    ACCEPTED = "the arm file's, as the person said"
    UNKNOWN = "the arm file's"

    @property
    def are_known(self) -> bool:
        """Whether joint positions are calibrated."""
        return self is not ZeroSource.UNKNOWN

    def require_known(self, arm: str) -> None:
        """Refuse a motion that needs calibrated joint positions.

        Raises:
            CalibrationError: The arm is not calibrated.
        """
        if not self.are_known:
            raise CalibrationError(f"{arm} is not calibrated.", _HINT.format(arm=arm))

    def check_small_steps(
        self, arm: str, start: Vector, goal: Vector, steps: Mapping[str, float]
    ) -> None:
        """Refuse motions (n,) longer than ``steps``, by joint, rad or m, if the zeros are unknown.

        Raises:
            CalibrationError: A joint would move further than ``steps`` allows.
        """
        if self.are_known:
            return
        for (name, step), distance in zip(steps.items(), abs(goal - start), strict=True):
            if distance > step * (1.0 + 1e-6):
                raise CalibrationError(
                    f"{arm} is not calibrated, and {name} would move by more than 10°.",
                    _HINT.format(arm=arm),
                )


def check_calibration_matches(
    calibration: Calibration, model: Model, usb_serial_number: str
) -> None:
    """Check a calibration against the arm file and the adapter.

    Raises:
        CalibrationError: The calibration belongs to another arm, or the arm file has changed since.
    """
    path = calibration_path(model.name, usb_serial_number)
    own = (calibration.arm, calibration.usb_serial_number)
    if own != (model.name, usb_serial_number):
        raise CalibrationError(
            f"{path} belongs to {own[0]} on "
            f"{f'adapter {own[1]}' if own[1] else 'an adapter without a serial number'}.",
            "If it is the same arm: ikservo calibration adopt. Otherwise: ikservo calibrate",
        )
    check_joints_match(calibration, model, str(path))


def check_joints_match(calibration: Calibration, model: Model, path: str) -> None:
    """Check the joints of a calibration against the arm file.

    Raises:
        CalibrationError: The arm file has different servos or a different chain.
    """
    filed = {
        joint.name: _format_servos([(servo.id, servo.model) for servo in joint.servos], joint.gear)
        for joint in calibration.joints
    }
    expected = {
        joint.name: _format_servos(
            [(servo.id, servo.model) for servo in (joint.servo, *joint.shadows)],
            joint.joint_map.gear,
        )
        for joint in model.joints
    }
    for name in filed.keys() | expected.keys():
        if filed.get(name) != expected.get(name):
            raise CalibrationError(
                f"{name} is {filed.get(name, 'unknown')} in {path} and "
                f"{expected.get(name, 'unknown')} in the arm file.",
                "Choose the right arm with --arm, or calibrate again: ikservo calibrate",
            )
    known = {step.joint.name for step in model.chain.joints_to()}
    for origin in calibration.geometry.origins if calibration.geometry else ():
        if origin.joint not in known:
            raise CalibrationError(
                f"The touch-off moved {origin.joint}, which is not between base and tip.",
                "The arm file has changed since. Repeat the touch-off: ikservo calibrate --touch",
            )


def _format_servos(servos: list[tuple[int, str]], gear: float) -> str:
    """Format servos as ``XM430-W350 (id 2)``."""
    listed = " and ".join(f"{model} (id {servo_id})" for servo_id, model in servos)
    return listed if abs(gear - 1.0) < 1e-9 else f"{listed} with gear {gear:.6g}"


class CalibratedArm:
    """The joints of the arm on a bus, with the zeros and ranges of this particular arm.

    Attributes:
        zeros: The source of the zeros.
        calibration: The calibration file, or None.
    """

    def __init__(
        self, bus: ServoBus, model: Model, zeros: ZeroSource, calibration: Calibration | None
    ) -> None:
        self._bus, self._model = bus, model
        self.zeros, self.calibration = zeros, calibration

    def joint_map(self, joint: ModelJoint) -> JointMap:
        """Return the map from the servo's present ticks to joint positions."""
        own = self._calibrated_joint(joint)
        if own is None:
            return joint.joint_map
        joint_map = own.joint_map(joint.joint_map)
        if not own.extended:
            return joint_map
        # A multi-turn servo may have started on another revolution than it was on at calibration.
        turn = round(self._bus.servos[own.servo.id].table.ticks_per_turn)
        present = self._bus.read(own.servo.id, RegisterName.PRESENT_POSITION, raw=True)
        low, high = own.travel_ticks
        turns = unwrap_near((low + high) // 2, present, turn) - present
        return joint_map.with_mounting(joint_map.sign, joint_map.zero_tick - turns)

    def limits(self, joint: ModelJoint, joint_map: JointMap) -> Limits:
        """Return the joint's range that arm file, calibration and servo registers allow.

        Raises:
            CalibrationError: There is no common range; the two contradicting limits are named.
        """
        own, servo_id = self._calibrated_joint(joint), joint.servo.id
        low = self._bus.read(servo_id, RegisterName.MIN_POSITION_LIMIT, raw=True)
        high = self._bus.read(servo_id, RegisterName.MAX_POSITION_LIMIT, raw=True)
        # Feetech: 0 and 0 stand for several revolutions without limits.
        registers = None if low == high == 0 else (low, high)
        if own is None or self.calibration is None:
            in_servo = _limits_from_registers(joint_map, registers) if registers else joint.limits
            return joint.limits.intersect(in_servo) if self.zeros.are_known else in_servo
        limits = calibrated_limits(self.calibration, own, joint)
        if own.extended or not registers or registers_allow(joint_map, limits, registers):
            return limits
        return limits.intersect(_limits_from_registers(joint_map, registers))

    def chain(self) -> Chain:
        """Return the arm's chain, with links, base and bending as far as they are calibrated."""
        chain = self._model.chain
        return chain if self.calibration is None else own_chain(self._model, self.calibration)

    def _calibrated_joint(self, joint: ModelJoint) -> CalibratedJoint | None:
        return self.calibration.joint(joint.name) if self.calibration else None


def own_chain(model: Model, calibration: Calibration) -> Chain:
    """Return the chain of an arm with links, base and bending from its calibration."""
    filed, chain = calibration.geometry, model.chain
    if filed is not None:
        from ikservo.kinematics.geometric_errors import apply_geometric_errors  # noqa: PLC0415

        chain = apply_geometric_errors(chain, geometric_errors_of(filed))
    return bent_chain(model, chain, calibration)


def bent_chain(model: Model, chain: Chain, calibration: Calibration) -> Chain:
    """Return a chain whose links bend as calibrated; the same chain if they are rigid."""
    if not any(joint.compliance or joint.play_deg for joint in calibration.joints):
        return chain
    bending = known_bending(model, chain, calibration)
    return replace(chain, link_joints=bending.link_joints)


def known_bending(model: Model, chain: Chain, calibration: Calibration | None) -> Bending:
    """Return the bending of a chain's links from a calibration; without one, zero bending."""
    found = [calibration and calibration.joint(name) for name in chain.names]
    compliance = np.array([joint.compliance if joint else 0.0 for joint in found])
    half_play = np.radians([joint.play_deg / 2.0 if joint else 0.0 for joint in found])
    from ikservo.kinematics.bending_and_backlash import Bending  # noqa: PLC0415  # few arms need it

    dynamics = Dynamics.from_masses(chain, link_masses(model, chain))
    return Bending(dynamics, compliance, half_play)


def load_calibration_for(
    bus: ServoBus, model: Model, *, uncalibrated: bool = False
) -> CalibratedArm:
    """Load the calibration of the arm on a bus, or accept the arm file's zeros.

    Raises:
        CalibrationError: The calibration contradicts the servos or the arm file, or its last write
            was interrupted.
        FileFormatError: The calibration is malformed.
    """
    if is_simulated(bus.port.name):
        return CalibratedArm(bus, model, ZeroSource.SIMULATED, None)
    serial = serial_number_of(bus.port.name)
    journal = journal_path(model.name, serial)
    if journal.exists():
        from ikservo.calibration.transaction import recover  # noqa: PLC0415  # after a crash

        recover(bus, journal)
    calibration = load_calibration(model.name, serial)
    if calibration is None:
        if is_pseudo_terminal(bus.port.name):
            zeros = ZeroSource.SIMULATED
        elif all(joint.zero_from == "vendor" for joint in model.joints):
            zeros = ZeroSource.VENDOR
        else:
            zeros = ZeroSource.ACCEPTED if uncalibrated else ZeroSource.UNKNOWN
        return CalibratedArm(bus, model, zeros, None)
    check_calibration_matches(calibration, model, serial)
    servos = [servo.id for joint in calibration.joints for servo in joint.servos]
    facts = {i: read_servo_config(bus, i) for i in servos}
    raise_on_mismatch(register_mismatches(calibration, facts))
    return CalibratedArm(bus, model, ZeroSource.CALIBRATED, calibration)


def check_servo_models(bus: ServoBus) -> None:
    """Check the models of the servos against the arm file.

    Raises:
        CalibrationError: A servo is of a different model.
        BusError: Servos do not answer; all of them are named.
    """
    numbers = read_register(bus, bus.servos, RegisterName.MODEL_NUMBER)
    for servo_id, number in numbers.items():
        servo = bus.servos[servo_id]
        if number != servo.table.number:
            other = control_table_for_number(servo.table.family, number)
            found = f"{other.model_name} ({number})" if other else f"model {number}"
            raise CalibrationError(
                f"{servo} is a {found}, but the arm file says {servo.table.model_name}.",
                "Is this another arm? Choose it with --arm. Otherwise two ids may be swapped.",
            )


def geometric_errors_of(filed: CalibratedGeometry) -> GeometricErrors:
    """Return the differences of an arm's links and base from its description, in SI units."""
    from ikservo.kinematics.geometric_errors import GeometricErrors  # noqa: PLC0415

    return GeometricErrors(
        base_m=np.array(filed.base_moved_mm) / 1000.0,
        base_rad=np.radians(filed.base_turned_deg),
        origins_m={row.joint: np.array(row.moved_mm) / 1000.0 for row in filed.origins},
    )


def _limits_from_registers(joint_map: JointMap, registers: tuple[int, int]) -> Limits:
    lower, upper = sorted(joint_map.position_clamped(tick) for tick in registers)
    return Limits.of(joint_map.joint, lower, upper, "servo register", joint_map.unit)


def registers_allow(joint_map: JointMap, limits: Limits, registers: tuple[int, int]) -> bool:
    """Check whether a servo's own limits allow every whole tick of a range."""
    low, high = joint_map.ticks_inside(limits.lower.value, limits.upper.value)
    return registers[0] <= low and high <= registers[1]


def calibrated_limits(calibration: Calibration, own: CalibratedJoint, joint: ModelJoint) -> Limits:
    """Return the range that arm file, calibration and the user's limits allow.

    Raises:
        CalibrationError: There is no common range; the two contradicting limits are named.
    """
    encoder = encoder_of(MODELS[own.servo.model])
    return calibration.narrow_limits(own, limit_to_one_turn(joint.limits, joint.joint_map, encoder))


def limit_to_one_turn(limits: Limits, joint_map: JointMap, encoder: Encoder) -> Limits:
    """Limit a joint to one revolution if the arm file gives it no limits."""
    if math.isfinite(limits.upper.value - limits.lower.value):
        return limits
    half = (encoder.ticks / 2 - 2) * joint_map.unit_per_tick
    turn = Limits.of(limits.joint, -half, half, "one turn of its servo", limits.unit)
    return limits.intersect(turn)


@dataclass(frozen=True, slots=True, eq=False)
class CalibratedModel:
    """An arm as described by its files.

    Attributes:
        model: The model with this arm's links, its chain and joints inside this arm's ranges.
        file: The calibration on which it is based; None if there is only the arm file.
        others: Older calibrations of arms of this kind, on other adapters.
    """

    model: Model
    file: Path | None = None
    others: tuple[Path, ...] = ()


def calibrated_model(model: Model) -> CalibratedModel:
    """Read the calibrations of an arm, without a bus; return the arm as in the newest one.

    A URDF without an arm file has no servos, and therefore no calibration.

    Raises:
        FileFormatError: A calibration is malformed.
        CalibrationError: The newest calibration has different servos or a different chain from the
            arm file, or leaves a joint without a range.
    """
    read = {path: read_calibration(path) for path in calibrations_of(model.name) if model.joints}
    if not read:
        return CalibratedModel(model)
    newest = max(read, key=lambda path: read[path].written)
    calibration = read[newest]
    # The chain to the arm's own tip identifies the arm, whatever tip the given model has.
    check_calibration_matches(calibration, load_model(model.path), calibration.usb_serial_number)
    others = tuple(path for path in read if path != newest)
    chain, joints = own_chain(model, calibration), list(model.joints)
    for i, joint in enumerate(joints):
        own = calibration.joint(joint.name)
        if own is not None:
            joints[i] = replace(joint, limits=calibrated_limits(calibration, own, joint))
    ranges = {joint.name: joint.limits for joint in joints}
    own_ranges = [ranges.get(name) for name in chain.names]
    lower = [-np.inf if limits is None else limits.lower.value for limits in own_ranges]
    upper = [np.inf if limits is None else limits.upper.value for limits in own_ranges]
    # Mimic joints may have narrowed the chain's own limits.
    chain = chain.with_limits(
        np.maximum(chain.lower_rad, lower), np.minimum(chain.upper_rad, upper)
    )
    calibrated = replace(model, chain=chain, joints=tuple(joints))
    return CalibratedModel(calibrated, newest, others)
