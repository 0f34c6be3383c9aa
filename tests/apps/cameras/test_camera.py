"""`arm.camera`: points of the table and of things from pixels of a calibrated camera."""

import math

import numpy as np
import pytest

import ikservo
from ikservo.apps.cameras.camera_file import SIMULATED, CameraCheck, load_camera, save_camera
from ikservo.calibration.paths import camera_path
from ikservo.errors import BadValueError, CalibrationError, FileFormatError, InputError
from ikservo.kinematics.packed import ROUNDING, SHAPE_WIDTH
from ikservo.kinematics.rays import Ray

pytest.importorskip("cv2")

from tests.apps.cameras.saved_camera import SEEN, save_simulated_camera


@pytest.fixture
def arm(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    with ikservo.open_arm("so101", "sim:?pose=home") as arm:
        save_simulated_camera(arm)
        yield arm


def test_table_point_and_pixel_are_converted_both_ways(arm):
    for point in ([0.25, 0.05, 0.0], [0.2, -0.1, 0.0], [0.3, 0.1, 0.04]):
        u, v = arm.camera.pixel(point)
        found = arm.camera.point_on_table(u, v, height_m=point[2])
        np.testing.assert_allclose(found, point, atol=1e-7)


def test_camera_ray_hits_obstacle_before_table(arm):
    arm.scene.add("box", "the crate", centre_m=(0.25, 0.1, 0.03), size_m=(0.06, 0.06, 0.06))
    u, v = arm.camera.pixel((0.25, 0.1, 0.06))
    seen = arm.camera.point_seen(u, v)
    assert seen.thing == "the crate"
    np.testing.assert_allclose(seen.point_m, [0.25, 0.1, 0.06], atol=1e-7)
    assert arm.camera.point_on_table(u, v)[2] == 0.0  # the table behind it
    u, v = arm.camera.pixel((0.2, -0.1, 0.0))
    assert arm.camera.point_seen(u, v).thing is None


def test_camera_ray_hits_surface_of_ball_and_cylinder(arm):
    ball, radius = np.array([0.25, 0.1, 0.05]), 0.04
    arm.scene.add("sphere", "the ball", centre_m=ball, radius_m=radius)
    arm.scene.add("cylinder", "the can", centre_m=(0.2, -0.1, 0.05), radius_m=0.03, height_m=0.1)
    eye = arm.camera.model().T_base_camera[:3, 3]
    u, v = arm.camera.pixel(ball)
    seen = arm.camera.point_seen(u, v)
    assert seen.thing == "the ball"
    towards = (eye - ball) / np.linalg.norm(eye - ball)
    np.testing.assert_allclose(seen.point_m, ball + radius * towards, atol=1e-6)
    aside = np.cross(towards, [0.0, 0.0, 1.0])
    beside = ball + 1.1 * radius * aside / np.linalg.norm(aside)  # in the box around it
    assert arm.camera.point_seen(*arm.camera.pixel(beside)).thing != "the ball"
    x, y, z = arm.camera.point_seen(*arm.camera.pixel((0.2, -0.1, 0.05))).point_m
    assert np.hypot(x - 0.2, y + 0.1) == pytest.approx(0.03, abs=1e-6) or z == pytest.approx(0.1)


def test_points_that_camera_cannot_see_are_refused(arm):
    with pytest.raises(InputError, match="does not meet the table"):
        arm.camera.point_on_table(480, 360, height_m=2.0)
    with pytest.raises(BadValueError, match="Expected finite numbers"):
        arm.camera.point_on_table(480, 360, height_m=math.nan)
    with pytest.raises(BadValueError, match="960 x 720"):
        arm.camera.point_on_table(-5, 360)
    with pytest.raises(BadValueError, match="960 x 720"):
        arm.camera.point_seen(math.nan, 360)
    with pytest.raises(BadValueError, match="'left'"):
        arm.camera.point_on_table("left", 360)
    with pytest.raises(InputError, match="behind the camera"):
        arm.camera.pixel((2.0, 0.5, 0.8))


def test_moved_camera_is_refused_until_it_is_moved_back(arm):
    _, known = load_camera("so101", SIMULATED)
    check = CameraCheck(seen=SEEN, off_mm=20, moved_mm=31.4, turned_deg=2.0, has_moved=True)
    save_camera("so101", SIMULATED, known.model_copy(update={"check": check}))
    with pytest.raises(CalibrationError, match=r"moved by 31 mm and turned by 2\.0°"):
        arm.camera.point_on_table(480, 500)
    back = check.model_copy(update={"has_moved": False})
    save_camera("so101", SIMULATED, known.model_copy(update={"check": back}))
    assert arm.camera.point_on_table(480, 500)[2] == 0.0


def test_missing_or_damaged_camera_file_is_refused(arm):
    path = camera_path("so101", SIMULATED)
    path.write_text(path.read_text().replace("after_mm", "after_cm"), encoding="utf-8")
    with pytest.raises(FileFormatError, match="checksum"):
        arm.camera.point_on_table(480, 500)
    path.unlink()
    with pytest.raises(CalibrationError, match="so101 has no calibrated camera"):
        arm.camera.point_on_table(480, 500)


@pytest.mark.parametrize(
    "wrong",
    [{"lens_px": (-900.0, 900.0, 480.0, 360.0)}, {"lens_px": (900.0, 0.0, 480.0, 360.0)},
     {"size_px": (0, 720)}],
)  # fmt: skip
def test_stored_lens_with_invalid_numbers_is_refused(arm, wrong):
    _, known = load_camera("so101", SIMULATED)
    camera = known.camera.model_copy(update=wrong)
    save_camera("so101", SIMULATED, known.model_copy(update={"camera": camera}))
    with pytest.raises(FileFormatError, match=next(iter(wrong))):
        arm.camera.point_on_table(480, 500)


def test_camera_ray_from_inside_bounding_box_hits_ball():
    eye, ball = np.full(3, 0.09), np.zeros(SHAPE_WIDTH)
    ball[:9], ball[ROUNDING] = np.eye(3).ravel(), 0.1
    towards = Ray(eye, np.full(3, -1 / math.sqrt(3)))
    assert towards.distance_to_thing_m(ball) == pytest.approx(math.sqrt(3) * 0.09 - 0.1, abs=1e-6)
    assert Ray(eye, -towards.direction).distance_to_thing_m(ball) == math.inf
    assert Ray(np.full(3, 0.01), towards.direction).distance_to_thing_m(ball) == math.inf, "inside"
