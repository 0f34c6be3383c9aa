"""``ikservo export csv``: a recording as a table."""

import csv
import io

import pytest

from ikservo.arm import open_arm
from ikservo.cli import main


@pytest.fixture
def recording(tmp_path):
    with open_arm("so101", port="sim") as arm:
        arm.record(tmp_path / "still.jsonl", duration_s=0.1)
        return tmp_path / "still.jsonl"


def test_export_csv_prints_recording_with_units_in_header(recording, capsys):
    assert main(["export", "csv", str(recording)]) == 0
    rows = list(csv.DictReader(io.StringIO(capsys.readouterr().out)))
    assert len(rows) == recording.read_text().count("\n") - 1
    assert "elbow_flex_rad" in rows[0]


def test_export_csv_writes_file_if_named(recording, tmp_path):
    assert main(["export", "csv", str(recording), "--to", str(tmp_path / "still.csv")]) == 0
    assert (tmp_path / "still.csv").read_text().startswith("t_s,shoulder_pan_rad,")


@pytest.mark.parametrize("words", [["csv"], ["excel"], ["csv", "/nope.jsonl"]])
def test_invalid_export_command_gives_usage_error(words):
    assert main(["export", *words]) == 2
