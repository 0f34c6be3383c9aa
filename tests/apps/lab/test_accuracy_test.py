"""``ikservo test``: its measurements, output and files, and its stop."""

import json
import re

import numpy as np
import pytest

from ikservo.apps.lab import accuracy_test
from ikservo.apps.lab.accuracy_report import accuracy_page, statements
from ikservo.errors import StoppedError

SIM = "--port sim:?pose=home"
SHORT = "--cycles 2 --path-cycles 2 --drift 1s"


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("ikservo.apps.lab.iso_cube.EDGES_M", (0.04,))  # takes less time
    monkeypatch.setattr(accuracy_test, "_DRIFT_CYCLES", 2)  # likewise
    return tmp_path


@pytest.mark.full
def test_pose_accuracy_is_reported_with_same_figures_on_page(run_cli, folder):
    result = run_cli(f"test planar2 {SIM} --parts poses --cycles 2 --html a.html --json --note 50g")
    assert result.code == 0
    answer = result.json
    judge_poses(answer)
    page = (folder / "a.html").read_text()
    embedded = json.loads(re.search(r'id="data">(.*?)</script>', page, re.DOTALL)[1])
    assert embedded["poses"] == answer["poses"]
    assert embedded["note"] == "50g"
    assert "http" not in page.replace("http-equiv", "")  # nothing is loaded from elsewhere
    judge_markup(answer)


def judge_poses(answer):
    assert answer["schema"] == "ikservo/test/1"
    assert [pose["name"] for pose in answer["poses"]] == ["P1", "P2", "P3", "P4", "P5"]
    for pose in answer["poses"]:
        points = np.array(pose["attained_m"])
        assert len(points) == pose["cycles"] == 2
        mean = points.mean(axis=0)
        assert pose["ap_m"] == pytest.approx(np.linalg.norm(mean - pose["target_m"]))
        far = np.linalg.norm(points - mean, axis=1)
        assert pose["rp_m"] == pytest.approx(far.mean() + 3 * far.std(ddof=1))
        assert pose["ap_m"] < 2e-3


def judge_markup(answer):
    """Check that neither a note nor a pose name can put markup into the page."""
    poses = [{**pose, "name": "<b>x</b>"} for pose in answer["poses"]]  # names are from a file
    page = accuracy_page({**answer, "poses": poses, "note": "</script><b>x</b>"})
    assert "<b>x</b>" not in page.partition('id="data"')[0]
    assert "</script><b>" not in page
    assert not any("Not complete" in text for text in statements(answer))


@pytest.mark.campaign
def test_accuracy_report_names_deviations_from_iso_9283(run_cli, folder):
    result = run_cli(f"test planar2 {SIM} --parts poses,drift --cycles 2 --drift 1s")
    assert result.code == 0
    assert re.search(r"^AP +P1 +\d+\.\d\d mm +2$", result.out, re.MULTILINE)
    assert "Measured with the arm's own joint sensors" in result.out
    assert "2 cycles of poses instead of 30" in result.out
    assert "drift over 1 s instead of an hour" in result.out
    (page,) = folder.glob("ikservo-test-planar2-*.html")
    assert f"Saved: {page.name}" in result.err


@pytest.mark.campaign
def test_accuracy_poses_are_approached_from_three_directions(run_cli):
    answer = run_cli(f"test planar2 {SIM} {SHORT} --parts directions --json").json
    assert [each["name"] for each in answer["directions"]] == ["P1", "P2", "P4"]
    assert all(each["vap_m"] < 5e-3 for each in answer["directions"])


@pytest.mark.campaign
def test_accuracy_paths_are_measured_at_three_speeds(run_cli):
    answer = run_cli(f"test planar2 {SIM} {SHORT} --parts paths --json").json
    found = {(path["shape"], path["speed_percent"]) for path in answer["paths"]}
    assert found == {(s, p) for s in ("line", "circle") for p in (100, 50, 10)}
    for path in answer["paths"]:
        assert path["tool_speed_m_s"] == pytest.approx(
            0.01 * path["speed_percent"] * answer["top_speed_m_s"]
        )
        assert 0.0 < path["at_m"] == pytest.approx(max(path["deviations_m"]))


@pytest.mark.full
@pytest.mark.parametrize(
    "error",
    [
        StoppedError("Stopped by the test."),
        pytest.param(SystemExit(143), marks=pytest.mark.campaign),
    ],
)
def test_stopped_accuracy_test_keeps_its_measurements(run_cli, folder, monkeypatch, error):
    measure = accuracy_test.AccuracyTest._measure_directions

    def stop(self):
        measure(self)
        self._arm.stop("Stopped by the test.")
        raise error

    monkeypatch.setattr(accuracy_test.AccuracyTest, "_measure_directions", stop)
    monkeypatch.setattr(accuracy_test, "_DIRECTION_POSES", ("P1",))
    result = run_cli(f"test planar2 {SIM} {SHORT} --parts directions --html a.html")
    assert result.code == 130  # the arm's stop is what ends the command
    assert "Not complete: Stopped by the test." in result.out
    assert "vAP" in result.out
    page = (folder / "a.html").read_text()
    assert "Not complete: Stopped by the test." in page


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--cycles 1", "number of cycles is 1"),
        ("--path-cycles 0", "cycles of a path is 0"),
        ("--drift 0", "not a time above 0"),
        ("--drift nan", "is not a time"),
        ("--parts poses,lines", "no part of the test named 'lines'"),
        ("--html there.html", "there.html exists."),
    ],
)
def test_bad_accuracy_test_settings_move_nothing(run_cli, folder, words, message):
    (folder / "there.html").write_text("mine")
    result = run_cli(f"test planar2 {SIM} {words}")
    assert result.code == 2
    assert message in result.err
    assert (folder / "there.html").read_text() == "mine"
