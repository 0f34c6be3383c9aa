"""Write a calibration to servos and file as one journaled transaction, all or nothing.

The journal is on disk before the first servo is written, and is removed after the file is written.
It contains the old and the new numbers, so that a later run can find out which servos were written,
and finish or undo the transaction.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from enum import Enum
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from ikservo.calibration.calibration_file import replace_calibration
from ikservo.errors import CalibrationError, FileFormatError, IkservoError
from ikservo.files.reading import MAX_BYTES, parse_toml, read_text, require_file
from ikservo.files.validation import StrictModel
from ikservo.files.writing import (
    FileWriteError,
    checked_toml,
    remove_durably,
    strip_checksum,
    write_atomic,
)
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.eeprom import back_up_once, lock_eeprom, register_differences, update_eeprom
from ikservo.hardware.register_batches import RegisterRef
from ikservo.registers import RegisterName

_HEADER = "# Values that ikservo is writing into servos. This file is removed afterwards.\n"
_Memory = Mapping[Annotated[str, Field(max_length=64)], int]


class EepromChange(StrictModel):
    """Registers of one servo that change, with their old and new raw values."""

    id: int = Field(ge=0, le=252, description="a whole number from 0 to 252")
    old: _Memory = Field(description="register = raw number")
    new: _Memory = Field(description="register = raw number")


class Journal(StrictModel):
    """A transaction: servos first, then the file.

    Attributes:
        path: The calibration file.
        old_text: The old content of the file; empty if there was none.
        new_text: The new content of the file.
        changes: The changes by servo, in the order in which they are written.
        temporary: Whether the new numbers are only for a search for end stops, and then undone.
    """

    format: Literal[1] = Field(description="1")
    path: str = Field(description="a file")
    old_text: str = Field(description="the old file")
    new_text: str = Field(description="the new file")
    changes: tuple[EepromChange, ...] = Field(strict=False, description="tables [[changes]]")
    temporary: bool = Field(default=False, description="true or false")


def dump_journal(journal: Journal) -> str:
    """Format a transaction as the text of its journal."""
    return checked_toml(_HEADER, journal.model_dump(mode="python", exclude_defaults=True))


def read_journal(path: Path) -> Journal | None:
    """Read the interrupted transaction, or None if there is none.

    Raises:
        FileFormatError: The journal is damaged.
    """
    if not path.exists():
        return None
    try:
        tables = parse_toml(path, strip_checksum(path, read_text(path, 4 * MAX_BYTES)))
    except FileFormatError as error:
        expected = "an intact journal. Remove it, then compare the servos: ikservo calibration diff"
        raise FileFormatError(path, error.where, error.found, expected) from error
    return Journal.from_tables(tables, path)


class TransactionProgress(Enum):
    """Progress of an interrupted transaction."""

    NOTHING = "no servo was changed"
    EVERYTHING = "every servo was changed"
    SOME = "some servos were changed"


def plan_changes(bus: ServoBus, expected: Mapping[int, Mapping[str, int]]) -> list[EepromChange]:
    """Plan the changes that give servos their expected raw numbers, by id and register.

    Raises:
        BusError: A servo does not reply.
    """
    changes: list[EepromChange] = []
    for servo_id, registers in expected.items():
        rows = register_differences(bus, servo_id, _register_values(bus, servo_id, registers))
        if rows:
            old = {str(row.register): row.found for row in rows}
            new = {str(row.register): row.expected for row in rows}
            changes.append(EepromChange(id=servo_id, old=old, new=new))
    return changes


def commit(
    bus: ServoBus,
    journal_path: Path,
    path: Path,
    text: str,
    changes: Sequence[EepromChange],
    *,
    temporary: bool = False,
) -> None:
    """Write servos and file in one transaction; after a failure, restore both.

    If this transaction fails, the changes of an earlier temporary transaction are undone, too.

    An empty text means no file. A ``temporary`` transaction is only for a search for end stops: the
    text is ignored, and the journal stays until ``roll_back`` or the next ``commit``.

    Raises:
        CalibrationError: Writing failed and could not be undone; the message says how to continue.
        IkservoError: Writing failed; nothing is changed.
    """
    journal = Journal(
        format=1,
        path=str(path),
        old_text=_text_of(path),
        new_text=text,
        changes=_join_changes(_find_interrupted(bus, journal_path), changes),
        temporary=temporary,
    )
    back_up_once(bus, bus.backup_owner, [each.id for each in journal.changes])
    try:
        write_atomic(journal_path, dump_journal(journal))
        _write_servos(bus, journal)
    except (IkservoError, KeyboardInterrupt, SystemExit) as error:  # also after SIGTERM
        try:
            _restore_servos(bus, journal)
        except IkservoError:
            raise _unfinished_error() from error
        with contextlib.suppress(FileWriteError):  # a journal that stays contains no changes
            remove_durably(journal_path)
        raise
    if not temporary:
        remove_durably(journal_path)


def _join_changes(
    earlier: Journal | None, changes: Sequence[EepromChange]
) -> tuple[EepromChange, ...]:
    """Merge changes with those of a temporary transaction, whose old numbers are kept."""
    joined = {each.id: each for each in changes}
    for each in earlier.changes if earlier is not None and earlier.temporary else ():
        later = joined.get(each.id, EepromChange(id=each.id, old={}, new={}))
        joined[each.id] = EepromChange(
            id=each.id, old={**later.old, **each.old}, new={**each.new, **later.new}
        )
    return tuple(joined.values())


def progress(bus: ServoBus, journal: Journal) -> TransactionProgress:
    """Return whether a transaction has changed no servo, some servos, or every servo.

    Raises:
        BusError: A servo does not reply.
    """
    olds = [not _memory_differs(bus, change.id, change.old) for change in journal.changes]
    news = [not _memory_differs(bus, change.id, change.new) for change in journal.changes]
    if all(news):
        return TransactionProgress.EVERYTHING
    return TransactionProgress.NOTHING if all(olds) else TransactionProgress.SOME


def recover(bus: ServoBus, journal_path: Path, *, calibrating: bool = False) -> str:
    """Complete or undo an interrupted transaction if that is safe without asking the user.

    If all servos or no servos were changed, only the file is written. A temporary transaction is
    undone if the torque of its servos is off.

    Args:
        bus: The servos.
        journal_path: The journal.
        calibrating: Whether the caller calibrates the arm, and undoes the remaining changes itself.

    Returns:
        Text for the user about what was done; empty if there was nothing to do.

    Raises:
        CalibrationError: Only some of the servos were changed, or a search for end stops has
            changed servos whose torque is on; the message says how to continue.
    """
    journal = _find_interrupted(bus, journal_path)
    if journal is None:
        return ""
    if journal.temporary:
        return _undo_search(bus, journal, journal_path, calibrating=calibrating)
    reached = progress(bus, journal)
    if reached is TransactionProgress.SOME:
        raise _unfinished_error()
    for change in journal.changes:  # a killed program may have left EEPROMs unlocked
        lock_eeprom(bus, change.id)
    if reached is TransactionProgress.EVERYTHING:
        _write_file(journal, journal.new_text, replace_calibration)
        remove_durably(journal_path)
        return "An interrupted calibration had reached all servos; its file has now been saved."
    _write_file(journal, journal.old_text, write_atomic)
    remove_durably(journal_path)
    return "An interrupted calibration had not changed anything yet; the previous one is valid."


def _undo_search(bus: ServoBus, journal: Journal, journal_path: Path, *, calibrating: bool) -> str:
    ids = [change.id for change in journal.changes]
    torque = bus.sync_read(ids, RegisterName.TORQUE_ENABLE, raw=True).require_all()
    if any(torque.values()):
        if calibrating:
            return ""
        raise CalibrationError(
            "A calibration was interrupted; the servos still have the settings of its search.",
            "Support the arm and undo it: ikservo calibration revert. Or calibrate again: "
            "ikservo calibrate",
        )
    _restore_servos(bus, journal)
    remove_durably(journal_path)
    return (
        "The servos had the settings of an interrupted search; the previous settings have "
        "been restored."
    )


def resume(bus: ServoBus, journal_path: Path) -> bool:
    """Finish an interrupted write; return whether there was one.

    Raises:
        CalibrationError: The write was temporary, and can only be undone.
        IkservoError: A servo still cannot be written; the journal stays.
    """
    return _end_interrupted(bus, journal_path, _write_servos)


def roll_back(bus: ServoBus, journal_path: Path) -> bool:
    """Undo an interrupted write; return whether there was one.

    Raises:
        IkservoError: A servo still cannot be written; the journal stays.
    """
    return _end_interrupted(bus, journal_path, _restore_servos)


def _end_interrupted(
    bus: ServoBus, journal_path: Path, write: Callable[[ServoBus, Journal], None]
) -> bool:
    """Write the rest of an interrupted transaction, or undo it; return whether there was one."""
    journal = _find_interrupted(bus, journal_path)
    if journal:
        if journal.temporary and write is _write_servos:
            hint = "Undo it: ikservo calibration revert. Or calibrate again: ikservo calibrate"
            raise CalibrationError("An interrupted search of end stops cannot be completed.", hint)
        write(bus, journal)
        remove_durably(journal_path)
    return journal is not None


def _find_interrupted(bus: ServoBus, journal_path: Path) -> Journal | None:
    """Find the interrupted transaction on this port's servos.

    Raises:
        CalibrationError: The journal's servo is not in the arm file, or belongs to another joint.
        FileFormatError: The journal is damaged.
    """
    journal = read_journal(journal_path)
    for change in journal.changes if journal else ():
        servo = bus.servos.get(change.id)
        names = change.old.keys() | change.new.keys()
        if servo is None or names - servo.table.registers.keys():
            raise CalibrationError(
                f"{journal_path}: interrupted write to servo {change.id}, which has changed since.",
                "Has the arm file changed? Use the earlier arm file, or remove this journal and "
                "compare: ikservo calibration diff",
            )
    return journal


def _write_servos(bus: ServoBus, journal: Journal) -> None:
    for change in journal.changes:
        update_eeprom(bus, change.id, _register_values(bus, change.id, change.new))
    _write_file(journal, journal.new_text, replace_calibration)


def _restore_servos(bus: ServoBus, journal: Journal) -> None:
    for change in journal.changes:
        update_eeprom(bus, change.id, _register_values(bus, change.id, change.old))
    _write_file(journal, journal.old_text, write_atomic)


def _write_file(journal: Journal, text: str, write: Callable[[Path, str], None]) -> None:
    path = Path(journal.path)
    if journal.temporary:
        return
    if not text:
        remove_durably(path)
    elif _text_of(path) != text:
        write(path, text)


def _text_of(path: Path) -> str:
    """Return the text of a file, even if it is damaged; empty if there is none."""
    if not path.exists():
        return ""
    require_file(path)
    with path.open(encoding="utf-8", errors="replace") as file:
        return file.read(MAX_BYTES)


def _unfinished_error() -> CalibrationError:
    return CalibrationError(
        "Writing a calibration was interrupted: some servos hold the new values, others the old.",
        "Finish it: ikservo calibration resume. Or undo it: ikservo calibration revert.",
    )


def _memory_differs(bus: ServoBus, servo_id: int, registers: Mapping[str, int]) -> bool:
    return bool(register_differences(bus, servo_id, _register_values(bus, servo_id, registers)))


def _register_values(
    bus: ServoBus, servo_id: int, registers: Mapping[str, int]
) -> dict[RegisterRef, int]:
    table = bus.servos[servo_id].table
    return {table.registers[name]: number for name, number in registers.items()}
