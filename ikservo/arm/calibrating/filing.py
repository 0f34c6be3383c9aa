"""A calibration file and its servos, brought together in one direction or the other."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path

from ikservo.arm.calibrating.belonging import check_belongs
from ikservo.arm.calibrating.by_hand import LooseArm
from ikservo.calibration.filing.record import CalibratedJoint, CalibratedServo, Calibration
from ikservo.calibration.filing.store import calibrations_of, load, save
from ikservo.calibration.in_servos.compare import Contradiction, contradictions_with
from ikservo.calibration.in_servos.memory import ServoFacts, counts_alike
from ikservo.calibration.sweeping.outcome import Outcome
from ikservo.calibration.ticks.encoder import encoder_of
from ikservo.errors import CalibrationError, FileFormatError
from ikservo.registers import Family

__all__ = ["differences", "lost_by_saving", "own_calibration", "pull", "push"]


def own_calibration(loose: LooseArm) -> Calibration:
    """Return the arm's calibration.

    Raises:
        CalibrationError: There is none.
        FileFormatError: It is spoiled.
    """
    name = loose.model.name
    calibration = load(name, loose.serial_number)
    if calibration is None:
        others = calibrations_of(name)
        adopt = f" Or adopt that of another adapter: ikservo calibration adopt {name}"
        raise CalibrationError(
            f"{name} is not calibrated: there is no {loose.path}.",
            f"Calibrate it: ikservo calibrate {name}.{adopt if others else ''}",
        )
    return calibration


def differences(loose: LooseArm) -> list[Contradiction]:
    """Return where the servos hold other numbers than the file."""
    return list(contradictions_with(own_calibration(loose), loose.facts))


def lost_by_saving(loose: LooseArm) -> Iterator[str]:
    """Yield what the calibration before knows and a new one does not, one line each."""
    with contextlib.suppress(FileFormatError):  # of one that is spoiled nothing is lost
        before = load(loose.model.name, loose.serial_number)
        if before and before.geometry:
            yield (
                "The link and base corrections of the touch-off of "
                f"{before.geometry.touched:%Y-%m-%d} are lost with the old zeros. "
                f"Repeat the touch-off: ikservo calibrate {loose.model.name} --touch"
            )


def push(loose: LooseArm) -> Path:
    """Make the servos hold what the file says; torque goes off first.

    Raises:
        CalibrationError: There is no file, or it is of other servos than the arm file's.
        IkservoError: It failed; nothing is changed, or the message says how to go on.
    """
    calibration = _of_these_servos(loose)
    memory = {s.id: s.holds for joint in calibration.joints for s in joint.servos}
    loose.let_go()
    return loose.save(Outcome(calibration, memory))


def pull(loose: LooseArm) -> Path:
    """Make the file say what the servos hold; zeros and travels move with the offsets.

    Raises:
        CalibrationError: There is no file, it is of other servos than the arm file's, or the
            servos count the other way round, not at all, or with a seam in a joint's travel.
    """
    calibration = _of_these_servos(loose)
    joints = tuple(_pulled(joint, loose.facts) for joint in calibration.joints)
    now = datetime.now(UTC).replace(microsecond=0)
    return save(calibration.model_copy(update={"joints": joints, "written": now}))


def _of_these_servos(loose: LooseArm) -> Calibration:
    calibration = own_calibration(loose)
    check_belongs(calibration, loose.model, loose.serial_number)
    return calibration


def _pulled(joint: CalibratedJoint, facts: Mapping[int, ServoFacts]) -> CalibratedJoint:
    lead = facts[joint.servo.id]
    if not all(counts_alike(facts[servo.id], servo.holds) for servo in joint.servos):
        raise CalibrationError(
            f"{joint.name} has another count direction than when calibrated; "
            "its sign and zero are invalid.",
            "Write the file's values into the servos instead: ikservo calibration push. "
            "Or measure again: ikservo calibrate",
        )
    shift = _shift(joint, lead)
    low, high = (tick + shift for tick in joint.travel_ticks)
    if not lead.counts_on and not 0 <= low < high < encoder_of(lead.table).ticks:
        raise CalibrationError(
            f"With the servo's present offset, the encoder of {joint.name} wraps inside its range.",
            "Write the file's values into the servos instead: ikservo calibration push",
        )
    return joint.model_copy(
        update={
            "zero_tick": joint.zero_tick + shift,
            "travel_ticks": (low, high),
            "extended": lead.counts_on,
            "servo": _holding(joint.servo, facts),
            "shadows": tuple(_holding(shadow, facts) for shadow in joint.shadows),
        }
    )


def _shift(joint: CalibratedJoint, lead: ServoFacts) -> int:
    """Return how far a servo's count has moved since the file was written."""
    moved = lead.held.get("homing_offset", 0) - joint.servo.holds.get("homing_offset", 0)
    shift = -moved if lead.table.family is Family.FEETECH_STS else moved
    turn = encoder_of(lead.table)
    if not turn.wraps or joint.extended:
        return shift
    # Where the count now begins elsewhere the travel may have moved by a turn.
    low = joint.travel_ticks[0] + shift
    return shift + (low % turn.ticks - low)


def _holding(servo: CalibratedServo, facts: Mapping[int, ServoFacts]) -> CalibratedServo:
    return servo.model_copy(update={"holds": dict(facts[servo.id].held)})
