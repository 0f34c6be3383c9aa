"""Servos and file change together: all of it, or nothing, whenever the power goes.

The journal is on disk before the first servo is written and goes away after the file is. Whoever
finds one knows both states, sees from the servos how far the writing came, and can finish it or
take it back.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from enum import Enum
from pathlib import Path

from ikservo.calibration.in_servos.journal import Change, Journal, journal_text, read_journal
from ikservo.errors import CalibrationError, IkservoError
from ikservo.files.writing import FileWriteError, remove, write_whole
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.keeping.eeprom import differences, update_eeprom
from ikservo.hardware.packets.notation import Wanted

__all__ = ["Progress", "changes_for", "commit", "progress", "resume", "revert", "settle"]


class Progress(Enum):
    """How far an interrupted writing came."""

    NOTHING = "no servo was changed"
    EVERYTHING = "every servo was changed"
    SOME = "some servos were changed"


def changes_for(bus: ServoBus, wanted: Mapping[int, Mapping[str, int]]) -> list[Change]:
    """Return what must be written so that servos hold what is wanted, raw, by id and register.

    Raises:
        BusError: A servo does not answer.
    """
    changes: list[Change] = []
    for servo_id, memory in wanted.items():
        rows = differences(bus, servo_id, _registers(bus, servo_id, memory))
        if rows:
            old = {str(row.register): row.found for row in rows}
            new = {str(row.register): row.wanted for row in rows}
            changes.append(Change(id=servo_id, old=old, new=new))
    return changes


def commit(
    bus: ServoBus, journal_path: Path, path: Path, text: str, changes: Sequence[Change]
) -> None:
    """Write servos and file as one; on a failure that can be taken back, everything is as before.

    Args:
        bus: The servos, torque off.
        journal_path: Where the journal stands meanwhile.
        path: The calibration file.
        text: What it shall hold; empty for no file.
        changes: What the servos shall hold.

    Raises:
        CalibrationError: It failed and could not be taken back; says how to go on.
        IkservoError: It failed; nothing is changed.
    """
    old_text = path.read_text("utf-8") if path.exists() else ""
    journal = Journal(
        format=1, path=str(path), old_text=old_text, new_text=text, changes=tuple(changes)
    )
    try:
        write_whole(journal_path, journal_text(journal))
        _write(bus, journal)
    except (IkservoError, KeyboardInterrupt) as error:
        _take_back(bus, journal, journal_path, error)
        raise
    remove(journal_path)


def progress(bus: ServoBus, journal: Journal) -> Progress:
    """Return how far a writing came.

    Raises:
        BusError: A servo does not answer.
    """
    olds = [not _differs(bus, change.id, change.old) for change in journal.changes]
    news = [not _differs(bus, change.id, change.new) for change in journal.changes]
    if all(news):
        return Progress.EVERYTHING
    return Progress.NOTHING if all(olds) else Progress.SOME


def settle(bus: ServoBus, journal_path: Path) -> str:
    """Clear up after an interrupted writing where that needs no servo to be written.

    Returns:
        What was done, for the person; empty where there was nothing to do.

    Raises:
        CalibrationError: Some servos are changed and some are not; says how to go on.
    """
    journal = _interrupted(bus, journal_path)
    if journal is None:
        return ""
    reached = progress(bus, journal)
    if reached is Progress.SOME:
        raise _unfinished()
    _lock(bus, journal)
    if reached is Progress.EVERYTHING:
        _save(journal)
        remove(journal_path)
        return "An interrupted calibration was complete in the servos; its file is saved now."
    _restore_file(journal)
    remove(journal_path)
    return "An interrupted calibration had changed nothing yet; the previous one is valid."


def resume(bus: ServoBus, journal_path: Path) -> bool:
    """Finish an interrupted writing; return whether there was one.

    Raises:
        IkservoError: A servo still cannot be written; the journal stays.
    """
    journal = _interrupted(bus, journal_path)
    if journal:
        _write(bus, journal)
        _lock(bus, journal)
        remove(journal_path)
    return journal is not None


def revert(bus: ServoBus, journal_path: Path) -> bool:
    """Take an interrupted writing back; return whether there was one.

    Raises:
        IkservoError: A servo still cannot be written; the journal stays.
    """
    journal = _interrupted(bus, journal_path)
    if journal:
        _undo(bus, journal)
        _lock(bus, journal)
        remove(journal_path)
    return journal is not None


def _interrupted(bus: ServoBus, journal_path: Path) -> Journal | None:
    """Return what was being written into the servos of this line.

    Raises:
        CalibrationError: It is of a servo that the arm file does not have, or has as another.
        FileFormatError: The journal is spoiled.
    """
    journal = read_journal(journal_path)
    for change in journal.changes if journal else ():
        servo = bus.servos.get(change.id)
        names = change.old.keys() | change.new.keys()
        if servo is None or not names <= servo.table.registers.keys():
            raise CalibrationError(
                f"{journal_path}: interrupted write to servo {change.id}, which is another now.",
                "Has the arm file changed? Use the earlier one, or remove this journal "
                "and compare: ikservo calibration diff",
            )
    return journal


def _write(bus: ServoBus, journal: Journal) -> None:
    for change in journal.changes:
        update_eeprom(bus, change.id, _registers(bus, change.id, change.new))
    _save(journal)


def _save(journal: Journal) -> None:
    path = Path(journal.path)
    if not journal.new_text:
        remove(path)
    elif not path.exists() or path.read_text("utf-8") != journal.new_text:
        write_whole(path, journal.new_text, keep_old=True)


def _undo(bus: ServoBus, journal: Journal) -> None:
    for change in journal.changes:
        update_eeprom(bus, change.id, _registers(bus, change.id, change.old))
    _restore_file(journal)


def _restore_file(journal: Journal) -> None:
    path = Path(journal.path)
    if not journal.old_text:
        remove(path)
    elif not path.exists() or path.read_text("utf-8") != journal.old_text:
        write_whole(path, journal.old_text)


def _take_back(bus: ServoBus, journal: Journal, journal_path: Path, cause: BaseException) -> None:
    try:
        _undo(bus, journal)
    except IkservoError:
        raise _unfinished() from cause
    with contextlib.suppress(FileWriteError):  # one that stays tells of nothing that was changed
        remove(journal_path)


def _lock(bus: ServoBus, journal: Journal) -> None:
    """Close memories that a killed program may have left open; nothing in them changes."""
    for change in journal.changes:
        lock = bus.servos[change.id].table.eeprom_lock
        if lock and bus.read(change.id, lock, raw=True) == 0:
            bus.write(change.id, lock, 1, raw=True)


def _unfinished() -> CalibrationError:
    return CalibrationError(
        "Writing a calibration was interrupted: some servos hold the new one, others the old.",
        "Finish it: ikservo calibration resume. Or undo it: ikservo calibration revert.",
    )


def _differs(bus: ServoBus, servo_id: int, memory: Mapping[str, int]) -> bool:
    return bool(differences(bus, servo_id, _registers(bus, servo_id, memory)))


def _registers(bus: ServoBus, servo_id: int, memory: Mapping[str, int]) -> dict[Wanted, int]:
    table = bus.servos[servo_id].table
    return {table.registers[name]: number for name, number in memory.items()}
