"""``ikservo camera tip``: the zero from a click on the tip is saved, used and undone."""

import numpy as np
import pytest

from ikservo.calibration.paths import calibration_path
from tests.cli.fixtures_mounted_arm import PORT, SERIAL

pytest.importorskip("cv2")

from tests.apps.cameras.mistaken_tip import ARM, JOINT, OFF_DEG, mistaken_tip, tip_pixel


def test_click_on_tip_sets_zero_of_last_joint_and_is_undone(tmp_path, monkeypatch, run_cli):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    arm, camera = mistaken_tip(monkeypatch)
    path = calibration_path(ARM, SERIAL)
    before = path.read_text()
    done = run_cli(f"pose home --arm {ARM} --port {PORT} --yes --no-wiggle")
    assert done.code == 0, done.err
    u, v = tip_pixel(arm, camera)
    words = f"camera tip {ARM} --port {PORT} --at"
    refused = run_cli(f"{words} {u + 90},{v - 90}")
    assert (refused.code, "every position that the tip can reach" in refused.err) == (6, True)
    assert path.read_text() == before
    done = run_cli(f"{words} {u},{v} --json")
    assert done.code == 0, done.err
    assert (done.json["joint"], done.json["path"]) == (JOINT, str(path))
    assert np.degrees(done.json["shift_rad"]) == pytest.approx(OFF_DEG, abs=0.4)
    assert path.read_text() != before
    assert run_cli(f"calibration undo {ARM} --port {PORT}").code == 0
    assert path.read_text() == before
    done = run_cli(f"{words} {u},{v} --at {u},{v}")
    assert "joint4 is +2." in done.out
    assert "by 2 of 2 clicks; standard error" in done.out
    assert "More clicks improve the result. Move joint" in done.err
    done = run_cli(f"{words} {u},{v} --json")
    assert (done.json["clicks"], done.json["counted"]) == (3, 3)
    assert done.json["error_deg"] == pytest.approx(1.5 / done.json["px_per_deg"] / 3**0.5, rel=0.2)
    assert done.json["error_m"] == pytest.approx(0.0022 * done.json["error_deg"], rel=0.05)
