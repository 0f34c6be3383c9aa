"""Arms with their own camera calibration go to clicked points: docs/how-to/camera.md."""

from datetime import UTC, datetime

import numpy as np
import pytest

from ikservo.arm.opening import open_own_arm
from ikservo.calibration.calibration_file import load_calibration
from ikservo.errors import CalibrationError
from tests.arm.seeds import log, part_of
from tests.calibration.mounted_arms import load_model
from tests.cli.fixtures_mounted_arm import PORT, SERIAL

pytest.importorskip("cv2")

from ikservo.apps.cameras.board_detection import find_board
from ikservo.apps.cameras.camera_calibration import (
    ArmBefore,
    CameraCalibration,
    save_camera_result,
)
from tests.apps.cameras.hidden_arms import (
    BOARD,
    click_errors_m,
    drawn_view,
    finish,
    hidden_arm,
    save_clicks,
    tip_errors_m,
)


def arm_before_a_camera(monkeypatch, name, seed):
    """Return a hidden arm, and a camera that sees its board."""
    chance = np.random.default_rng(1000 + seed)
    while True:
        arm, camera = hidden_arm(monkeypatch, name, seed, view=drawn_view(chance))
        try:
            find_board(BOARD, camera.take())
        except CalibrationError:
            continue
        return arm, camera


def calibrate(name, camera, pictures):
    """Let an arm calibrate itself in front of a camera; save and return the result."""
    with open_own_arm(load_model(name), PORT) as opened:
        result = finish(CameraCalibration(opened, camera, BOARD, pictures).run())
        save_camera_result(
            ArmBefore.of(opened), "0", result, datetime.now(UTC).replace(microsecond=0)
        )
    return result


def errors_of_an_arm(monkeypatch, name, seed, pictures, points):
    """Let an arm calibrate itself, and click on its tip three times if asked to.

    Returns:
        The distances between the tip and clicked points, and between the true and the computed tip
        in the camera frame over its workspace, m; and the camera.
    """
    arm, camera = arm_before_a_camera(monkeypatch, name, seed)
    model, result = load_model(name), calibrate(name, camera, pictures)
    assert result.duration_s < 180.0
    assert result.tip_shows == {"open_manipulator_x": "joint4"}.get(name)
    if result.tip_shows:
        save_clicks(arm, camera, np.random.default_rng(seed))
    with open_own_arm(model, PORT) as opened:
        here, names = opened.where(), opened.chain.names
        off = np.array([here[each].position_rad - arm.true_position(each) for each in names])
        T_camera_base = np.linalg.inv(opened.camera.model().T_base_camera)
        everywhere_m = tip_errors_m(arm, camera, opened.chain, off, T_camera_base)
        return click_errors_m(arm, camera, opened, points, seed), everywhere_m, camera


@pytest.mark.campaign
@pytest.mark.timeout(0)
@pytest.mark.parametrize("name", ["so101", "koch", "open_manipulator_x"])
def test_tip_reaches_clicked_points_within_4_mm(tmp_path, monkeypatch, capsys, name):
    clicked, everywhere = [], []
    for seed in part_of(30):
        monkeypatch.setenv("IKSERVO_HOME", str(tmp_path / str(seed)))
        at_clicks_m, everywhere_m, _ = errors_of_an_arm(monkeypatch, name, seed, 30, 20)
        clicked.append(at_clicks_m)
        everywhere.append(everywhere_m)
        log(capsys, f"{name} {seed}: clicks {in_mm(clicked[-1])}; tip {in_mm(everywhere[-1])}")
    log(capsys, f"{name}: {len(clicked)} arms: clicks {in_mm(clicked)}; tip {in_mm(everywhere)}")
    assert np.median(clicked) < 0.002
    assert np.percentile(clicked, 95) < 0.004
    assert np.median(everywhere) < 0.0015
    assert np.percentile(everywhere, 95) < 0.003


def in_mm(errors_m):
    median, most = np.percentile(1000.0 * np.array(errors_m), [50, 95])
    return f"{median:.2f} mm, 95 % {most:.2f}"


@pytest.mark.campaign
@pytest.mark.timeout(600)
def test_tip_clicks_find_last_joint_zero_that_board_cannot(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    name = "open_manipulator_x"
    clicked, _, camera = errors_of_an_arm(monkeypatch, name, 2, 14, 6)
    assert np.median(clicked) < 0.002  # 6 mm without
    assert clicked.max() < 0.004
    assert len(load_calibration(name, SERIAL).camera.tip_clicks) == 3
    with open_own_arm(load_model(name), PORT) as opened:
        opened.pose("home")
    calibrate(name, camera, 8)
    assert load_calibration(name, SERIAL).camera.tip_clicks == ()
