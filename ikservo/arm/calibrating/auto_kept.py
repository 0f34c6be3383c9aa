"""What a self-calibration that was interrupted has measured: kept on disk, and used again.

The travel of a joint between its stops is kept in ticks of the bare encoder: these stay the same
whatever is written into the servo, and wherever the arm is held when the next run begins.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime

from ikservo.arm.calibrating.by_hand import LooseArm
from ikservo.calibration.filing.partial import (
    MeasuredJoint,
    PartialCalibration,
    partial_text,
    read_partial,
)
from ikservo.calibration.sweeping.homing import Travel
from ikservo.calibration.sweeping.measured import measure
from ikservo.calibration.sweeping.subject import Subject
from ikservo.calibration.sweeping.sweep import Wizard
from ikservo.errors import CalibrationError, FileFormatError
from ikservo.files.writing import remove, write_whole

__all__ = ["KeptTravels", "with_known"]


class KeptTravels:
    """The measured joints of one arm on one adapter.

    Args:
        loose: The arm.

    Attributes:
        path: The file.
        travels: The measured joints, as the file has them; none where there is no sound file.
        written: When the file was written; empty where there is none.
    """

    def __init__(self, loose: LooseArm) -> None:
        self._loose, self.path = loose, loose.partial_path
        found = _read(loose)
        self.written = found.written if found else ""
        rows = found.joints if found else ()
        self.travels = {j.name: Travel(j.low_tick, j.high_tick) for j in rows if self._is_ours(j)}

    def keep(self, subject: Subject, travel: Travel) -> None:
        """Add a joint to the file.

        Raises:
            FileWriteError: The disk will not take it.
        """
        self.travels[subject.name] = travel
        write_whole(self.path, partial_text(self._partial()))

    def forget(self) -> None:
        """Remove the file: a calibration has been saved, or all is measured anew.

        Raises:
            FileWriteError: It stays.
        """
        self.travels.clear()
        remove(self.path)

    def _is_ours(self, joint: MeasuredJoint) -> bool:
        facts = self._loose.facts.get(joint.servo_id)
        ids = {j.name: j.servo.id for j in self._loose.model.joints}
        known = ids.get(joint.name) == joint.servo_id and joint.low_tick < joint.high_tick
        return known and facts is not None and facts.table.model_name == joint.servo_model

    def _partial(self) -> PartialCalibration:
        ids = {joint.name: joint.servo.id for joint in self._loose.model.joints}
        rows = [
            MeasuredJoint(
                name=name,
                servo_id=ids[name],
                servo_model=self._loose.facts[ids[name]].table.model_name,
                low_tick=travel.low,
                high_tick=travel.high,
            )
            for name, travel in self.travels.items()
        ]
        now = datetime.now(UTC).isoformat(timespec="seconds")
        arm = self._loose.model.name
        return PartialCalibration(format=1, arm=arm, written=now, joints=tuple(rows))


def with_known(wizard: Wizard, travels: Mapping[str, Travel]) -> Wizard:
    """Return a conversation, its anchor taken, in which measured joints are not swept again.

    A joint that now stands outside what was measured is measured anew.
    """
    subjects = (_known(wizard, s, travels.get(s.name)) for s in wizard.subjects)
    return replace(wizard, subjects=tuple(subjects))


def _known(wizard: Wizard, subject: Subject, travel: Travel | None) -> Subject:
    known = replace(subject, known=travel)
    try:
        measure(wizard, known)
    except CalibrationError:
        return subject
    return known


def _read(loose: LooseArm) -> PartialCalibration | None:
    try:
        found = read_partial(loose.partial_path)
    except FileFormatError:  # no more than some minutes of work: measured anew
        return None
    return found if found and found.arm == loose.model.name else None
