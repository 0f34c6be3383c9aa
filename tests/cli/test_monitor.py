"""``ikservo monitor``: logs and reports; nothing moves."""

import pytest


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))


@pytest.mark.parametrize("arm", ["so101", "koch"])
def test_each_run_adds_a_record(run_cli, arm, tmp_path):
    line = f"monitor --arm {arm} --port sim --duration 0.3 --json"
    first, second = run_cli(line).json, run_cli(line).json
    assert (first["count"], second["count"], second["changes"]) == (1, 2, [])
    assert first["joints"][0]["lost"] == 0
    report = run_cli(f"monitor --arm {arm} --port sim --report")
    assert "2 records" in report.err
    assert len(list((tmp_path / "health").glob("*.jsonl"))) == 1
