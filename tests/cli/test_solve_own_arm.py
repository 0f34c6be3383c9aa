"""``ikservo solve`` and ``workspace`` inside the calibrated limits of the user's arm."""

from datetime import UTC, datetime, timedelta

import pytest

from ikservo.calibration.calibration_file import save_calibration
from tests.calibration.factories import make_calibration
from tests.calibration.mounted_arms import make_mounted_arm

WHEN = datetime(2026, 11, 2, 14, 3, 22, tzinfo=UTC)
AT_THE_SIDE = "0 0.25 0.1 --arm so101"  # the sweep below turns the pan by 63° and no further


@pytest.fixture(autouse=True)
def _home(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))


@pytest.fixture
def file():
    """Return the calibration file of an SO-101 swept by 63° to both sides of home."""
    arm = make_mounted_arm("so101", 4, spoiled=False)
    with arm.open_limp() as limp_arm:
        calibration = make_calibration(arm, limp_arm, WHEN)
    older = {"written": WHEN - timedelta(days=9), "usb_serial_number": "OLDER"}
    save_calibration(calibration.model_copy(update=older))
    return save_calibration(calibration)


def test_solve_refuses_point_beyond_the_swept_range(run_cli, file):
    assert run_cli(f"solve {AT_THE_SIDE}").code == 7
    file.unlink()
    (file.parent / "so101-OLDER.toml").unlink()
    assert run_cli(f"solve {AT_THE_SIDE}").code == 0


def test_solve_names_swept_range_as_limit_in_effect(run_cli, file):
    binding = run_cli(f"solve {AT_THE_SIDE} --json").json["binding"]
    assert any(
        words.startswith("shoulder_pan at its ") and words.endswith("(hand sweep of 2026-11-02)")
        for words in binding
    )


def test_solve_json_states_source_of_each_limit(run_cli, file):
    assert any("hand sweep" in s for s in run_cli(f"solve {AT_THE_SIDE} --json").json["limit_from"])


def test_solve_prints_used_calibration_to_stderr(run_cli, file):
    result = run_cli(f"solve {AT_THE_SIDE}")
    assert result.err == f"Limits from calibration: {file} (the newest; older files: 1)\n"


@pytest.mark.sample(2)
@pytest.mark.parametrize("how", ["--all", "--compare", "--method closed_form", "--pitch 0"])
def test_every_solve_method_stays_in_swept_range(run_cli, file, how):
    assert run_cli(f"solve {AT_THE_SIDE} {how}").code == 7


def test_workspace_stays_in_swept_range(run_cli, file):
    result = run_cli(f"workspace --arm so101 --point {AT_THE_SIDE.split(' --', maxsplit=1)[0]}")
    assert result.code == 7
    assert "(hand sweep of 2026-11-02)" in result.out
    assert str(file) in result.err


def test_solve_with_damaged_calibration_gives_one_error(run_cli, file):
    file.write_text("format = 1\n")
    result = run_cli(f"solve {AT_THE_SIDE}")
    assert result.code != 0
    assert str(file) in result.err
    assert result.out == ""
