"""The results of an interrupted calibration are kept, and accepted completely or not at all."""

import pytest
from pydantic import ValidationError

from ikservo.calibration.records import (
    PartialCalibration,
    StoredJointMeasurement,
    dump_partial,
    read_partial,
)
from ikservo.errors import FileFormatError
from ikservo.files.writing import with_checksum

JOINT = {"name": "elbow", "servo_id": 3, "servo_model": "STS3215", "low_tick": -20, "high_tick": 7}
TABLE = {"format": 1, "arm": "so101", "written": "2026-11-02 14:03", "joints": [JOINT]}


def partial_of(**changes):
    return PartialCalibration.model_validate({**TABLE, "joints": [{**JOINT, **changes}]})


def test_partial_calibration_survives_write_and_read(tmp_path):
    path, partial = tmp_path / "so101.partial", PartialCalibration.model_validate(TABLE)
    path.write_text(dump_partial(partial))
    assert read_partial(path) == partial
    assert "The next run continues from here" in path.read_text()


def test_missing_partial_calibration_reads_as_none(tmp_path):
    assert read_partial(tmp_path / "so101.partial") is None


@pytest.mark.parametrize("servo_id", [0, 252])
def test_partial_calibration_accepts_ids_0_to_252(servo_id):
    assert partial_of(servo_id=servo_id).joints == (
        StoredJointMeasurement.model_validate({**JOINT, "servo_id": servo_id}),
    )


@pytest.mark.parametrize(
    ("old", "new", "where"),
    [
        ("servo_id = 3", "servo_id = 253", "joints[0].servo_id"),
        ("servo_id = 3", "servo_id = -1", "joints[0].servo_id"),
        ("servo_id = 3", 'servo_id = "3"', "joints[0].servo_id"),
        ("low_tick = -20", "low_tick = -20.5", "joints[0].low_tick"),
        ("format = 1", "format = 2", "format"),
        ('name = "elbow"', f'name = "{"e" * 65}"', "joints[0].name"),
        ('"STS3215"', f'"{"e" * 65}"', "joints[0].servo_model"),
        ('arm = "so101"', f'arm = "{"e" * 65}"', "arm"),
        ('written = "2026-11-02 14:03"', f'written = "{"e" * 65}"', "written"),
        ("high_tick", "highest_tick", "joints[0].high"),
    ],
)
def test_partial_calibration_error_names_place_of_value(tmp_path, old, new, where):
    path = tmp_path / "so101.partial"
    body = dump_partial(PartialCalibration.model_validate(TABLE)).partition("\n")[2]
    assert old in body
    path.write_text(with_checksum(body.replace(old, new)))
    with pytest.raises(FileFormatError) as caught:
        read_partial(path)
    assert where in caught.value.where


def test_partial_calibration_accepts_names_of_64_characters():
    longest = "e" * 64
    partial = PartialCalibration.model_validate(
        {**TABLE, "arm": longest, "written": longest,
         "joints": [{**JOINT, "name": longest, "servo_model": longest}]}
    )  # fmt: skip
    assert (partial.arm, partial.joints[0].name) == (longest, longest)


def test_partial_calibration_is_immutable():
    with pytest.raises(ValidationError):
        partial_of().joints[0].low_tick = 0


def test_truncated_partial_calibration_is_refused(tmp_path):
    path = tmp_path / "so101.partial"
    path.write_text(dump_partial(PartialCalibration.model_validate(TABLE))[:-5])
    with pytest.raises(FileFormatError, match="is damaged"):
        read_partial(path)
