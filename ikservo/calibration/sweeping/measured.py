"""What a conversation found out about one joint, in bare ticks."""

from __future__ import annotations

from dataclasses import dataclass

from ikservo.calibration.filing.record import Swept
from ikservo.calibration.sweeping.homing import Travel
from ikservo.calibration.sweeping.obstacles import goes_round
from ikservo.calibration.sweeping.subject import Subject
from ikservo.calibration.sweeping.sweep import Wizard
from ikservo.calibration.ticks.joint_map import JointMap
from ikservo.calibration.ticks.limits import Limits
from ikservo.calibration.ticks.seam import nearest_turn
from ikservo.errors import CalibrationError

__all__ = ["Measured", "measure"]


@dataclass(frozen=True, slots=True)
class Measured:
    """A joint's mounting and travel.

    Attributes:
        joint_map: Its sign and zero; in bare ticks, once moved by ``shifted`` in reported ones.
        travel: How far it goes, in the same ticks.
        swept: Who found that out.
    """

    joint_map: JointMap
    travel: Travel
    swept: Swept

    def shifted(self, shift: int) -> Measured:
        """Return the same joint counted from ``shift`` ticks further on."""
        moved = self.joint_map.placed(self.joint_map.sign, self.joint_map.zero_tick - shift)
        travel = Travel(self.travel.low - shift, self.travel.high - shift)
        return Measured(moved, travel, self.swept)

    def ends(self, margin_rad: float) -> tuple[float, float] | None:
        """Return the positions a margin inside both ends; None where nobody swept it."""
        if self.swept == "not swept":
            return None
        margin = margin_rad / self.joint_map.horn_rad_per_tick
        inside = (self.travel.low + margin, self.travel.high - margin)
        low, high = sorted(self.joint_map.position(tick) for tick in inside)
        return low, high

    def limits(self, expected: Limits, margin_rad: float, user: Limits | None) -> Limits:
        """Return the range that sweep, arm file and person leave together.

        Raises:
            CalibrationError: Nothing; names the two that exclude each other.
        """
        ends = self.ends(margin_rad)
        if ends:
            swept = Limits.of(expected.joint, *ends, "hand sweep", expected.unit)
            expected = expected.intersect(swept)
        return expected.intersect(user) if user else expected


def measure(wizard: Wizard, subject: Subject) -> Measured:
    """Return what was found out about a joint, in bare ticks.

    Raises:
        CalibrationError: A range that was known before does not hold the anchor pose.
    """
    track, anchor = wizard.tracks[subject.servo_id], wizard.anchor[subject.servo_id]
    placed, name = subject.placed(wizard.sign(subject), anchor), subject.name
    if subject.known:
        earlier: Swept = "by itself" if wizard.driven else "by LeRobot"
        return Measured(placed, _around(subject, subject.known, anchor), earlier)
    if name in wizard.skipped or name in wizard.free or goes_round(wizard, subject):
        expected = subject.expected
        ends = placed.ticks_inside(expected.lower.value, expected.upper.value)
        return Measured(placed, Travel(*ends), "not swept")
    who: Swept = "by itself" if wizard.driven else "by hand"
    return Measured(placed, Travel(track.low, track.high), who)


def _around(subject: Subject, known: Travel, anchor: float) -> Travel:
    """Return a travel moved by whole turns to where the anchor is."""
    shift = 0
    if subject.turn:
        middle = (known.low + known.high) // 2
        shift = nearest_turn(round(anchor), middle, subject.turn) - middle
    if not known.low + shift - 1 <= anchor <= known.high + shift + 1:
        raise CalibrationError(
            f"{subject.name}: the anchor pose is outside the range that was recorded before.",
            "Is the arm in that pose, and the file this arm's? Otherwise: ikservo calibrate",
        )
    return Travel(known.low + shift, known.high + shift)
