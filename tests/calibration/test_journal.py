"""The journal of registers to write is on disk first, and accepted completely or not at all."""

import pytest
from pydantic import ValidationError

from ikservo.calibration.transaction import EepromChange, Journal, dump_journal, read_journal
from ikservo.errors import FileFormatError
from ikservo.files.reading import MAX_BYTES
from ikservo.files.writing import with_checksum

LONGEST = "e" * 64


def change(servo_id=1, register="homing_offset"):
    return EepromChange.model_validate({"id": servo_id, "old": {register: 0}, "new": {register: 7}})


def journal(*changes, old_text="", new_text="[arm]"):
    return Journal(
        format=1, path="so101.toml", old_text=old_text, new_text=new_text, changes=changes
    )


def test_calibration_journal_survives_write_and_read(tmp_path):
    path, written = tmp_path / "journal.toml", journal(change(0), change(252, LONGEST))
    path.write_text(dump_journal(written))
    assert read_journal(path) == written


def test_missing_calibration_journal_reads_as_none(tmp_path):
    assert read_journal(tmp_path / "journal.toml") is None


def test_journal_accepts_two_calibrations_of_maximum_size(tmp_path):
    path, whole = tmp_path / "journal.toml", "#" * MAX_BYTES
    written = journal(change(), old_text=whole, new_text=whole)
    path.write_text(dump_journal(written))
    assert read_journal(path) == written


def test_calibration_journal_is_immutable():
    with pytest.raises(ValidationError):
        journal(change()).changes[0].id = 2


@pytest.mark.parametrize(
    ("old", "new", "where"),
    [
        ("id = 1", "id = 253", "changes[0].id"),
        ("id = 1", "id = -1", "changes[0].id"),
        ("homing_offset = 7", 'homing_offset = "7"', "changes[0].new"),
        ("homing_offset = 7", f"{LONGEST}e = 7", "changes[0].new"),
        ("format = 1", "format = 2", "format"),
        ("new_text", "newest_text", "newest_text"),
    ],
)
def test_calibration_journal_error_names_place_of_bad_value(tmp_path, old, new, where):
    path = tmp_path / "journal.toml"
    body = dump_journal(journal(change())).partition("\n")[2]
    assert old in body
    path.write_text(with_checksum(body.replace(old, new)))
    with pytest.raises(FileFormatError) as caught:
        read_journal(path)
    assert where in caught.value.where


def test_truncated_calibration_journal_is_refused_with_remedy(tmp_path):
    path = tmp_path / "journal.toml"
    path.write_text(dump_journal(journal(change()))[:-5])
    with pytest.raises(FileFormatError, match="is damaged") as caught:
        read_journal(path)
    assert "ikservo calibration diff" in caught.value.expected
