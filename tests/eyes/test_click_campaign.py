"""Arms that calibrated themselves go where the picture is clicked: docs/how-to/camera.md."""

from datetime import UTC, datetime

import numpy as np
import pytest

from ikservo.arm.opening import open_own_arm
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
from tests.eyes.hidden_arms import BOARD, click_errors_m, drawn_view, hidden_arm


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


@pytest.mark.campaign
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("name", ["so101", "koch"])
@pytest.mark.parametrize("seed", range(9))
def test_the_tip_goes_where_the_picture_is_clicked(tmp_path, monkeypatch, name, seed):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    arm, camera = arm_before_a_camera(monkeypatch, name, seed)
    model = load_model(name)
    with open_own_arm(model, PORT) as opened:
        result = CameraCalibration(opened, camera, BOARD, 30).run()
        save_camera_result(
            ArmBefore.of(opened), "0", result, datetime.now(UTC).replace(microsecond=0)
        )
    assert result.duration_s < 180.0
    with open_own_arm(model, PORT) as opened:
        errors = click_errors_m(arm, camera, opened, 20, seed)
    assert np.median(errors) < 0.002
    assert np.percentile(errors, 95) < 0.004
