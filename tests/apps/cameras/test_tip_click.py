"""A click on the tip gives the zero of a last joint that the board does not show."""

from datetime import timedelta

import numpy as np
import pytest

import ikservo
from ikservo.apps.cameras.camera_file import CameraCheck, load_camera, save_camera
from ikservo.arm.opening import open_own_arm
from ikservo.calibration.calibration_file import (
    load_calibration,
    save_calibration,
    undo_calibration,
)
from ikservo.calibration.paths import calibration_path
from ikservo.errors import BadValueError, CalibrationError
from tests.calibration.mounted_arms import load_model
from tests.cli.fixtures_mounted_arm import PORT, SERIAL, WHEN

pytest.importorskip("cv2")

from ikservo.apps.cameras.camera_check import check_camera
from ikservo.apps.cameras.tip_click import find_tip_zero, save_tip_zero
from tests.apps.cameras.hidden_arms import click_on_tip, follow_advice, save_clicks
from tests.apps.cameras.mistaken_tip import ARM, JOINT, OFF_DEG, mistaken_tip, tip_pixel
from tests.apps.cameras.saved_camera import SEEN


@pytest.fixture
def mistaken(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    return mistaken_tip(monkeypatch)


@pytest.fixture
def opened(mistaken):
    with open_own_arm(load_model(ARM), PORT) as opened:
        opened.enable()  # limp it sinks
        yield opened


def click(opened, pixel):
    return find_tip_zero(opened, [pixel], WHEN)


def blind_posture(arm, camera, opened):
    """Return joints (dof,) at which the last one swings the tip along the line of sight."""
    chain, chance = opened.chain, np.random.default_rng(0)
    tried = chance.uniform(chain.lower_rad, chain.upper_rad, (3000, chain.dof))
    gripper = arm.true_position("gripper")

    def seen(q):
        positions = dict(zip(chain.names, q, strict=True)) | {"gripper": gripper}
        tip = arm.world.tip.position_m([positions[joint.name] for joint in arm.world.joints])
        return tip, camera.pixel(tip)

    moved = []
    for q in tried:
        (tip, px), (_, then) = seen(q), seen(q + np.radians([0.0, 0.0, 0.0, 1.0]))
        shows = 0.0 < px[0] < 960.0 and 0.0 < px[1] < 720.0 and tip[2] > 0.08 and tip[0] > 0.1
        moved.append(np.linalg.norm(then - px) if shows else np.inf)
    return tried[np.argmin(moved)]


def test_tip_click_corrects_zero_and_keeps_camera_check_valid(mistaken, opened):
    arm, camera = mistaken
    found = click(opened, tip_pixel(arm, camera))
    assert found.joint == JOINT
    assert np.degrees(found.shift_rad) == pytest.approx(OFF_DEG, abs=0.4)  # ticks
    before = check_camera(opened, camera, WHEN)[0]
    save_tip_zero(opened, found)
    opened.close()
    with open_own_arm(load_model(ARM), PORT) as again:
        assert again.where()[JOINT].position_rad == pytest.approx(
            arm.true_position(JOINT), abs=7e-3
        )
        after = check_camera(again, camera, WHEN)[0]
        assert (before.has_moved, after.has_moved) == (False, False)
        assert after.off_mm == pytest.approx(before.off_mm, abs=0.3)
        assert click(again, tip_pixel(arm, camera)).shift_rad == pytest.approx(0.0, abs=2e-3)


@pytest.mark.parametrize(
    ("away_px", "text"),
    [
        ((60.0, -40.0), "mm or more from every position that the tip can reach"),
        ((0.0, 120.0), "tip can reach"),
    ],
)
def test_tip_click_far_from_possible_positions_is_refused(mistaken, opened, away_px, text):
    u, v = tip_pixel(*mistaken)
    with pytest.raises(CalibrationError, match=text):
        click(opened, (u + away_px[0], v + away_px[1]))
    with pytest.raises(BadValueError, match="a pixel of the 960 x 720 picture"):
        click(opened, (u, 4000.0))


def test_tip_click_implying_zero_error_of_10_deg_is_refused(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    arm, camera = mistaken_tip(monkeypatch, off_deg=10.5)
    with open_own_arm(load_model(ARM), PORT) as opened:
        opened.enable()
        with pytest.raises(CalibrationError, match="off by 10° or more"):
            click(opened, tip_pixel(arm, camera))


def test_tip_click_in_insensitive_posture_suggests_another(mistaken, opened):
    arm, camera = mistaken
    opened.move_joints(
        dict(zip(opened.chain.names, blind_posture(arm, camera, opened), strict=True))
    )
    with pytest.raises(CalibrationError, match="Each degree of joint4 moves the tip by") as refused:
        click(opened, tip_pixel(arm, camera))
    assert refused.value.hint.startswith("Move joint")
    found = click_on_tip(arm, camera, opened, np.random.default_rng(0), noise_px=0.0)
    assert np.degrees(found.shift_rad) == pytest.approx(OFF_DEG, abs=0.4)  # ticks


def clicked(arm, camera, wrong_deg=0.0):
    """Click where the tip would be with its joint further; save that, and go there."""
    with open_own_arm(load_model(ARM), PORT) as opened:
        opened.enable()
        positions = {joint.name: joint.position for joint in arm.world.joints}
        positions[JOINT] += np.radians(wrong_deg)
        pixel = camera.pixel(arm.world.tip.position_m(list(positions.values())))
        found = click(opened, pixel)
        save_tip_zero(opened, found)
        follow_advice(opened, found.advice)
        return found


def zero_error_deg(arm):
    """Return the error of the last joint's measured angle: less than a tick if all is right."""
    with open_own_arm(load_model(ARM), PORT) as opened:
        measured = opened.where()[JOINT].position_rad
        return np.degrees(arm.true_position(JOINT) - measured)


def test_tip_clicks_in_more_postures_reduce_zero_error(mistaken):
    arm, camera = mistaken
    assert "tip_clicks" not in calibration_path(ARM, SERIAL).read_text()
    found = [clicked(arm, camera) for _ in range(3)]
    assert [len(each.counts) for each in found] == [1, 2, 3]
    errors_deg = [each.error_deg for each in found]
    assert (np.diff(errors_deg) < 0.0).all()
    assert errors_deg[0] == pytest.approx(
        1.5 / found[0].px_per_deg, rel=0.1
    )  # the camera's is less
    assert found[0].error_m == pytest.approx(0.0022 * found[0].error_deg, abs=5e-5)  # of the tip
    assert found[1].px_per_deg > 1.1 * found[0].px_per_deg  # it asks for such a posture
    assert zero_error_deg(arm) == pytest.approx(0.0, abs=0.4)  # ticks
    kept = load_calibration(ARM, SERIAL).camera.tip_clicks
    assert np.mean([each.off_deg for each in kept]) == pytest.approx(0.0, abs=0.1)
    undo_calibration(calibration_path(ARM, SERIAL))
    assert load_calibration(ARM, SERIAL).camera.tip_clicks == found[1].calibration.camera.tip_clicks


def test_mean_of_tip_clicks_is_better_than_worst_click(mistaken):
    arm, camera = mistaken
    chance = np.random.default_rng(3)
    found = save_clicks(arm, camera, chance, count=6)
    assert abs(zero_error_deg(arm)) < 3.0 * found.error_deg
    off_deg = np.abs(found.others_deg)
    assert found.error_deg < 0.5 * off_deg.max()


def test_outlier_tip_click_is_reported_and_ignored(mistaken):
    arm, camera = mistaken
    clicked(arm, camera)
    two = clicked(arm, camera, wrong_deg=4.0)
    assert (two.counts, two.are_apart) == ((True, True), True)
    assert "differ by more than their error" in str(two)
    assert two.error_deg > 1.0
    three = clicked(arm, camera)
    assert (three.counts, three.are_apart) == ((True, False, True), False)
    assert f"Click 2 differs by {three.others_deg[1]:+.1f}°, more" in str(three)
    assert zero_error_deg(arm) == pytest.approx(0.0, abs=0.5)
    assert len(load_calibration(ARM, SERIAL).camera.tip_clicks) == 3


def test_warning_is_given_if_half_of_tip_clicks_are_ignored(mistaken):
    arm, camera = mistaken
    clicked(arm, camera)
    clicked(arm, camera)
    assert "No more clicks count" not in str(clicked(arm, camera, wrong_deg=4.0))
    four = clicked(arm, camera, wrong_deg=4.0)
    assert sum(four.counts) == 2
    assert "Half of the clicks or more were ignored" in str(four)


def test_tip_clicks_in_one_picture_share_its_camera_error(mistaken, opened):
    pixel = np.array(tip_pixel(*mistaken))
    around = [tuple(pixel + each) for each in ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))]
    once, found = click(opened, pixel), find_tip_zero(opened, around, WHEN)
    assert found.shift_rad == pytest.approx(once.shift_rad, abs=1e-3)
    one = once.calibration.camera.tip_clicks[0]
    error_deg = np.hypot(one.click_deg / 2.0, one.camera_deg)  # the camera's stays
    assert found.error_deg == pytest.approx(error_deg, rel=0.02)


def test_tip_click_is_refused_for_zero_already_calibrated(mistaken, opened):
    known = load_calibration(ARM, SERIAL)
    shown = known.camera.model_copy(update={"tip_shows": None})
    save_calibration(known.with_cameras({"": shown}))
    with pytest.raises(CalibrationError, match="cannot set the zero of joint4"):
        click(opened, tip_pixel(*mistaken))


def test_tip_click_is_refused_after_calibration_has_changed(mistaken, opened):
    found = click(opened, tip_pixel(*mistaken))
    save_tip_zero(opened, found)
    with pytest.raises(CalibrationError, match="changed since the arm was opened"):
        click(opened, tip_pixel(*mistaken))


def test_tip_click_does_not_overwrite_newer_calibration(mistaken, opened):
    found = click(opened, tip_pixel(*mistaken))
    known = load_calibration(ARM, SERIAL)
    other = known.model_copy(update={"written": known.written + timedelta(seconds=1)})
    save_calibration(other)
    with pytest.raises(CalibrationError, match="changed since the click"):
        save_tip_zero(opened, found)
    assert load_calibration(ARM, SERIAL) == other


def test_tip_click_is_refused_if_camera_has_moved(mistaken, opened):
    _, known = load_camera(ARM, SERIAL)
    check = CameraCheck(seen=SEEN, off_mm=20, moved_mm=31.4, turned_deg=2.0, has_moved=True)
    save_camera(ARM, SERIAL, known.model_copy(update={"check": check}))
    with pytest.raises(CalibrationError, match="has moved by 31 mm"):
        click(opened, tip_pixel(*mistaken))


def test_tip_click_is_refused_while_arm_moves(mistaken, opened):
    opened.disable_torque()
    with pytest.raises(CalibrationError, match="The arm is moving"):
        click(opened, tip_pixel(*mistaken))


def test_tip_click_is_refused_on_simulated_arm(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    with ikservo.open_arm(ARM, "sim:?pose=home") as arm:
        arm.enable()
        with pytest.raises(CalibrationError, match="no calibrated camera"):
            click(arm, (480.0, 360.0))
