"""What is known of this very arm: its calibration file, checked against its servos."""

from __future__ import annotations

import math

import numpy as np

from ikservo.arm.calibrating.belonging import check_belongs
from ikservo.arm.streaming.asking import ask_all
from ikservo.arm.trust import Zeros
from ikservo.calibration import JointMap, Limits
from ikservo.calibration.filing.record import CalibratedGeometry, CalibratedJoint, Calibration
from ikservo.calibration.filing.store import journal_path, load
from ikservo.calibration.in_servos.compare import contradictions_with, refuse
from ikservo.calibration.in_servos.memory import facts_of
from ikservo.calibration.in_servos.transaction import settle
from ikservo.calibration.ticks.encoder import Encoder, encoder_of
from ikservo.calibration.ticks.seam import nearest_turn
from ikservo.errors import CalibrationError
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.line import replug
from ikservo.hardware.line.pseudo_terminal import is_pseudo_terminal
from ikservo.kinematics import Chain
from ikservo.kinematics.geometry import Geometry, corrected
from ikservo.model import Model, ModelJoint
from ikservo.registers import MODELS, Role, table_with_number

__all__ = [
    "OwnArm",
    "calibrated_limits",
    "check_models",
    "geometry_of",
    "holds_free",
    "own_arm",
    "serial_number_of",
    "simulated",
    "within_a_turn",
]

_SIMULATED = "sim"


class OwnArm:
    """The joints of the arm that is on the line, with this arm's zeros and ranges.

    Attributes:
        zeros: Where its zeros come from.
        calibration: What its file says, or None.
    """

    def __init__(
        self, bus: ServoBus, model: Model, zeros: Zeros, calibration: Calibration | None
    ) -> None:
        self._bus, self._model = bus, model
        self.zeros, self.calibration = zeros, calibration

    def joint_map(self, joint: ModelJoint) -> JointMap:
        """Return how the ticks that the servo reports at present relate to the joint."""
        own = self._own(joint)
        if own is None:
            return joint.joint_map
        return self._this_turn(own, own.joint_map(joint.joint_map))

    def limits(self, joint: ModelJoint, joint_map: JointMap) -> Limits:
        """Return the joint's range: arm file, calibration and servo registers, whichever binds.

        Raises:
            CalibrationError: Nothing lies inside all of them; names the two that exclude it.
        """
        own, registers = self._own(joint), self._registers(joint)
        if own is None or self.calibration is None:
            in_servo = _between(joint_map, registers) if registers else joint.limits
            return joint.limits.intersect(in_servo) if self.zeros.known else in_servo
        limits = calibrated_limits(self.calibration, own, joint)
        if own.extended or not registers or holds_free(joint_map, limits, registers):
            return limits
        return limits.intersect(_between(joint_map, registers))

    def chain(self) -> Chain:
        """Return the arm's chain with the links and the base that a touch-off found."""
        chain, filed = self._model.chain, self.calibration and self.calibration.geometry
        return corrected(chain, geometry_of(filed)) if filed else chain

    def _own(self, joint: ModelJoint) -> CalibratedJoint | None:
        return self.calibration.joint(joint.name) if self.calibration else None

    def _registers(self, joint: ModelJoint) -> tuple[int, int] | None:
        """Return the position limits that stand in the servo; None where they are no limits."""
        low = self._bus.read(joint.servo.id, Role.MIN_POSITION_LIMIT, raw=True)
        high = self._bus.read(joint.servo.id, Role.MAX_POSITION_LIMIT, raw=True)
        return None if low == high == 0 else (low, high)  # Feetech: several turns, no limits

    def _this_turn(self, own: CalibratedJoint, joint_map: JointMap) -> JointMap:
        """Return the map for the turn on which a servo that counts on has begun this time."""
        if not own.extended:
            return joint_map
        turn = round(self._bus.servos[own.servo.id].table.ticks_per_turn)
        present = self._bus.read(own.servo.id, Role.PRESENT_POSITION, raw=True)
        low, high = own.travel_ticks
        turns = nearest_turn((low + high) // 2, present, turn) - present
        return joint_map.placed(joint_map.sign, joint_map.zero_tick - turns)


def own_arm(bus: ServoBus, model: Model, *, uncalibrated: bool = False) -> OwnArm:
    """Find out what is known of the arm on the line.

    Args:
        bus: Its servos.
        model: What the arm file says.
        uncalibrated: Whether the person vouches for the arm file's zeros.

    Raises:
        CalibrationError: The calibration contradicts the servos or the arm file, or was left
            half written.
        FileFormatError: The calibration is spoiled.
    """
    if simulated(bus.port.name):
        return OwnArm(bus, model, Zeros.SIMULATED, None)
    serial = serial_number_of(bus.port.name)
    settle(bus, journal_path(model.name, serial))
    calibration = load(model.name, serial)
    if calibration is None:
        served = is_pseudo_terminal(bus.port.name)
        zeros = Zeros.SIMULATED if served else _nominal(model, uncalibrated)
        return OwnArm(bus, model, zeros, None)
    check_belongs(calibration, model, serial)
    servos = [servo.id for joint in calibration.joints for servo in joint.servos]
    facts = {i: facts_of(bus, i) for i in servos}
    refuse(contradictions_with(calibration, facts))
    return OwnArm(bus, model, Zeros.CALIBRATED, calibration)


def check_models(bus: ServoBus) -> None:
    """Compare the servos' models with the arm file's.

    Raises:
        CalibrationError: A servo is of another model.
        BusError: A servo does not answer; names all that do not.
    """
    numbers = ask_all(bus, bus.servos, Role.MODEL_NUMBER)
    for servo_id, number in numbers.items():
        servo = bus.servos[servo_id]
        if number != servo.table.number:
            other = table_with_number(servo.table.family, number)
            found = f"{other.model_name} ({number})" if other else f"model {number}"
            raise CalibrationError(
                f"{servo} is a {found}, the arm file says {servo.table.model_name}.",
                "Another arm (choose it with --arm), or two swapped ids.",
            )


def simulated(port_name: str) -> bool:
    """Return whether a port is the simulated bus in this process, fresh at each opening."""
    return port_name.partition(":")[0] == _SIMULATED


def serial_number_of(port_name: str) -> str:
    """Return the serial number of the USB adapter behind a port; empty where there is none."""
    return _SIMULATED if simulated(port_name) else replug.serial_number_of(port_name)


def geometry_of(filed: CalibratedGeometry) -> Geometry:
    """Return how an arm's links and base differ from its description, in SI units."""
    return Geometry(
        base_m=np.array(filed.base_moved_mm) / 1000.0,
        base_rad=np.radians(filed.base_turned_deg),
        origins_m={row.joint: np.array(row.moved_mm) / 1000.0 for row in filed.origins},
    )


def _nominal(model: Model, accepted: bool) -> Zeros:
    if all(joint.zero_from == "vendor" for joint in model.joints):
        return Zeros.VENDOR
    return Zeros.ACCEPTED if accepted else Zeros.UNKNOWN


def _between(joint_map: JointMap, registers: tuple[int, int]) -> Limits:
    lower, upper = sorted(joint_map.furthest(tick) for tick in registers)
    return Limits.of(joint_map.joint, lower, upper, "servo register", joint_map.unit)


def holds_free(joint_map: JointMap, limits: Limits, registers: tuple[int, int]) -> bool:
    """Return whether a servo's own limits leave every whole tick of a range free."""
    low, high = joint_map.ticks_inside(limits.lower.value, limits.upper.value)
    return registers[0] <= low and high <= registers[1]


def calibrated_limits(calibration: Calibration, own: CalibratedJoint, joint: ModelJoint) -> Limits:
    """Return the range inside arm file, calibration and what the person set.

    Raises:
        CalibrationError: Nothing lies inside all of them; names the two that exclude it.
    """
    encoder = encoder_of(MODELS[own.servo.model])
    return calibration.narrowed(own, within_a_turn(joint.limits, joint.joint_map, encoder))


def within_a_turn(limits: Limits, joint_map: JointMap, encoder: Encoder) -> Limits:
    """Return limits that a servo can tell apart, where the arm file gives a joint none."""
    if math.isfinite(limits.upper.value - limits.lower.value):
        return limits
    half = (encoder.ticks / 2 - 2) * joint_map.unit_per_tick
    turn = Limits.of(limits.joint, -half, half, "one turn of its servo", limits.unit)
    return limits.intersect(turn)
