"""Whether a calibration file and the servos on the line still tell the same story."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from ikservo.calibration.filing.record import CalibratedServo, Calibration
from ikservo.calibration.in_servos.memory import ServoFacts, differs
from ikservo.errors import CalibrationError

__all__ = ["Contradiction", "contradictions_with", "refuse"]


@dataclass(frozen=True, slots=True)
class Contradiction:
    """A register that does not hold what it held when the arm was calibrated.

    Attributes:
        joint: Whose servo it is.
        servo_id: Its id.
        register: By name; ``model`` for the servo itself.
        filed: What the file says.
        found: What the servo says.
    """

    joint: str
    servo_id: int
    register: str
    filed: str
    found: str

    def __str__(self) -> str:
        return (
            f"{self.register} of {self.joint} (id {self.servo_id}) is {self.found} in the servo "
            f"and {self.filed} in the calibration"
        )


def contradictions_with(
    calibration: Calibration, facts: Mapping[int, ServoFacts]
) -> Iterator[Contradiction]:
    """Yield where the servos differ from a calibration, joint by joint."""
    for joint in calibration.joints:
        for servo in joint.servos:
            if servo.id not in facts:
                yield Contradiction(joint.name, servo.id, "id", str(servo.id), "not this arm's")
            else:
                yield from _of_servo(joint.name, servo, facts[servo.id])


def _of_servo(joint: str, servo: CalibratedServo, facts: ServoFacts) -> Iterator[Contradiction]:
    if servo.model != facts.table.model_name:
        yield Contradiction(joint, servo.id, "model", servo.model, facts.table.model_name)
        return
    for name, filed in servo.holds.items():
        found = facts.held.get(name)
        if found is None:
            yield Contradiction(joint, servo.id, name, str(filed), "unknown")
        elif differs(name, filed, found):
            yield Contradiction(joint, servo.id, name, str(filed), str(found))


def refuse(contradictions: Iterable[Contradiction]) -> None:
    """Refuse to go on where there are contradictions.

    Raises:
        CalibrationError: Names the first, with both values, and how to go on.
    """
    first, *more = [*contradictions, None]
    if first is None:
        return
    rest = f", and {len(more) - 1} more" if len(more) > 1 else ""
    raise CalibrationError(
        f"{first}{rest}.",
        "See all: ikservo calibration diff. Write the file's values into the servos: "
        "ikservo calibration push. Measure again: ikservo calibrate",
    )
