"""Arms that calibrated themselves go where the picture is clicked: docs/how-to/camera.md."""

from datetime import UTC, datetime

import numpy as np
import pytest

from ikservo.arm.opening import open_own_arm
from ikservo.calibration.calibration_file import save_calibration
from ikservo.errors import CalibrationError
from tests.calibration.mounted_arms import load_model
from tests.cli.fixtures_mounted_arm import PORT

pytest.importorskip("cv2")

from ikservo.eyes.pictures import find_board
from ikservo.maintenance.camera_calibration import (
    ArmBefore,
    CameraCalibration,
    save_camera_result,
)
from tests.eyes.hidden_arms import BOARD, click_errors_m, click_on_tip, drawn_view, hidden_arm


def arm_before_a_camera(monkeypatch, name, seed):
    """Return a hidden arm, and a camera somewhere that sees its board."""
    chance = np.random.default_rng(1000 + seed)
    while True:
        arm, camera = hidden_arm(monkeypatch, name, seed, view=drawn_view(chance))
        try:
            find_board(BOARD, camera.take())
        except CalibrationError:
            continue
        return arm, camera


def clicked_errors_m(monkeypatch, name, seed, pictures, points):
    """Let an arm calibrate itself, click on its tip where that is asked for, and on points."""
    arm, camera = arm_before_a_camera(monkeypatch, name, seed)
    model = load_model(name)
    with open_own_arm(model, PORT) as opened:
        result = CameraCalibration(opened, camera, BOARD, pictures).run()
        save_camera_result(
            ArmBefore.of(opened), "0", result, datetime.now(UTC).replace(microsecond=0)
        )
    assert result.duration_s < 180.0
    assert result.tip_shows == {"open_manipulator_x": "joint4"}.get(name)
    if result.tip_shows:
        with open_own_arm(model, PORT) as opened:
            found = click_on_tip(arm, camera, opened, np.random.default_rng(seed))
            save_calibration(found.calibration)
    with open_own_arm(model, PORT) as opened:
        return click_errors_m(arm, camera, opened, points, seed)


CAMPAIGN = {"so101": 9, "koch": 9, "open_manipulator_x": 10}


@pytest.mark.campaign
@pytest.mark.timeout(3600)
@pytest.mark.parametrize(
    ("name", "seed"), [(name, seed) for name, count in CAMPAIGN.items() for seed in range(count)]
)
def test_the_tip_goes_where_the_picture_is_clicked(tmp_path, monkeypatch, name, seed):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    errors = clicked_errors_m(monkeypatch, name, seed, 30, 20)
    assert np.median(errors) < 0.002
    assert np.percentile(errors, 95) < 0.004


@pytest.mark.full
@pytest.mark.timeout(600)
def test_a_last_joint_that_no_board_shows_is_known_after_a_click_on_the_tip(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    errors = clicked_errors_m(monkeypatch, "open_manipulator_x", 2, 14, 6)
    assert np.median(errors) < 0.002  # 6 mm without
    assert errors.max() < 0.004
