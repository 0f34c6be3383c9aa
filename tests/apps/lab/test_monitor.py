"""``ikservo monitor``: logs and reports; nothing moves."""

import json

import pytest


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))


@pytest.mark.parametrize("arm", ["so101", "koch"])
def test_each_monitor_run_adds_one_record(run_cli, arm, tmp_path):
    line = f"monitor --arm {arm} --port sim --duration 0.3 --json"
    first, second = run_cli(line).json, run_cli(line).json
    assert (first["count"], second["count"], second["changes"]) == (1, 2, [])
    assert first["joints"][0]["lost"] == 0
    report = run_cli(f"monitor --arm {arm} --port sim --report")
    assert "2 records" in report.err
    assert len(list((tmp_path / "health").glob("*.jsonl"))) == 1


def test_monitor_report_names_joints_with_unknown_backlash(run_cli, tmp_path):
    run_cli("monitor --arm koch --port sim --duration 0.1")
    (path,) = (tmp_path / "health").glob("*.jsonl")
    found = {"name": "elbow_flex", "id": 3, "backlash_rad": 0.02, "backlash_error_rad": 0.001}
    record = {"written": "2026-03-02T00:00:00Z", "source": "identify", "joints": [found]}
    path.write_text(f"{path.read_text()}{json.dumps(record)}\n")
    text = run_cli("monitor --arm koch --port sim --report").out
    assert (
        "shoulder_pan, shoulder_lift: unknown, because their servos do not measure current" in text
    )
    assert "Backlash of wrist_flex, wrist_roll: unknown until ikservo identify finds it" in text
