"""The camera model projects as OpenCV does, and rays pass through their points."""

import math

import numpy as np
import pytest

from ikservo.apps.cameras.board_detection import Intrinsics
from ikservo.apps.cameras.camera_model import CameraModel
from ikservo.errors import BadValueError
from ikservo.kinematics.rays import Ray
from ikservo.kinematics.se3 import exp_so3, log_so3, make_pose, rotation_rpy

cv2 = pytest.importorskip("cv2")

LENSES = [
    (0.0, 0.0, 0.0, 0.0, 0.0),
    (-0.12, 0.04, 0.0, 0.0, 0.0),
    (0.2, -0.3, 0.002, -0.001, 0.1),
    (-0.35, 0.12, 0.001, 0.002, -0.02),
]


def camera_of(distortion):
    matrix = np.array([[900.0, 0, 470.0], [0, 910.0, 365.0], [0, 0, 1.0]])
    pose = make_pose([0.5, 0.1, 0.4], exp_so3([0.3, -1.9, 1.2]))
    return CameraModel(Intrinsics(matrix, np.array(distortion), (960, 720)), pose)


@pytest.mark.parametrize("distortion", LENSES)
def test_camera_model_matches_opencv_and_inverts_to_rays(distortion):
    camera = camera_of(distortion)
    chance = np.random.default_rng(0)
    flat = chance.uniform([-0.5, -0.38], [0.5, 0.38], (300, 2))
    ahead = np.column_stack([flat, np.ones(300)]) * chance.uniform(0.2, 2.0, (300, 1))
    T = camera.T_base_camera
    points = ahead @ T[:3, :3].T + T[:3, 3]
    px, depth_m = camera.project(points)
    there = np.linalg.inv(T)
    said, _ = cv2.projectPoints(
        points, log_so3(there[:3, :3]), there[:3, 3], camera.lens.matrix, camera.lens.distortion
    )
    np.testing.assert_allclose(px, said[:, 0], atol=1e-6)
    np.testing.assert_allclose(depth_m, ahead[:, 2], atol=1e-9)
    inside = np.all((px >= 0) & (px <= [959, 719]), axis=1)
    assert inside.sum() > 200
    for (u, v), point in zip(px[inside], points[inside], strict=True):
        sight = camera.ray(u, v)
        away = point - sight.origin_m
        assert np.linalg.norm(np.cross(away, sight.direction)) < 1e-8
        assert away @ sight.direction > 0


@pytest.mark.parametrize("distortion", LENSES)
def test_points_far_outside_view_project_outside_picture(distortion):
    camera = camera_of(distortion)
    angles = np.linspace(0.0, 2 * math.pi, 24)
    rays = np.array([[math.cos(a), math.sin(a)] for a in angles])
    radii = np.linspace(0.01, 6.0, 200)
    away = [np.linalg.norm(camera.pixels(r * rays) - [470.0, 365.0], axis=1) for r in radii]
    assert (np.diff(away, axis=0) > 0).all()  # a lens whose polynomial turns back would fold it


@pytest.mark.parametrize("pixel", [(-1.0, 5.0), (5.0, 720.0), (math.nan, 5.0), (5.0, math.inf)])
def test_pixel_outside_picture_is_refused(pixel):
    with pytest.raises(BadValueError, match="960 x 720"):
        camera_of(LENSES[1]).ray(*pixel)


def test_camera_ray_meets_plane_below_and_boxes_from_outside():
    down = np.array([0.6, 0.0, -0.8])
    sight = Ray(np.array([0.0, 0.0, 0.4]), down)
    np.testing.assert_allclose(sight.at(sight.distance_to_level_m(0.0)), [0.3, 0.0, 0.0])
    assert sight.distance_to_level_m(0.5) == math.inf  # behind it
    assert Ray(sight.origin_m, np.array([1.0, 0, 0])).distance_to_level_m(0) == math.inf
    half = np.array([0.05, 0.05, 0.1])
    upright, turned = np.eye(3), rotation_rpy(0.0, 0.0, math.pi / 4)
    hit = sight.at(sight.distance_to_box_m(upright, np.array([0.25, 0.0, 0.1]), half))
    np.testing.assert_allclose(hit, [0.2, 0.0, 0.4 - 0.8 / 3], atol=1e-9)  # its side
    corner = sight.at(sight.distance_to_box_m(turned, np.array([0.25, 0.0, 0.1]), half))
    assert corner[0] == pytest.approx(0.25 - math.sqrt(2) * 0.05, abs=1e-9)
    assert sight.distance_to_box_m(upright, np.array([0.25, 0.2, 0.1]), half) == math.inf
    assert sight.distance_to_box_m(upright, sight.origin_m, half) == math.inf  # from inside


def test_strongly_distorted_lens_is_inverted_everywhere():
    lens = np.array([[327.0, 0, 333.5], [0, 327.0, 243.5], [0, 0, 1.0]])
    bent = np.array([-0.43, 0.088, 0.0, 0.0, 0.0])
    camera = CameraModel(Intrinsics(lens, bent, (640, 480)), np.eye(4))
    for u in range(0, 640, 71):
        for v in range(0, 480, 53):
            seen = camera.ray(u, v).at(1.0)
            np.testing.assert_allclose(camera.project(seen)[0], (u, v), atol=1e-6)


def test_pixel_without_valid_ray_is_refused():
    lens = np.array([[327.0, 0, 333.5], [0, 327.0, 243.5], [0, 0, 1.0]])
    folded = np.array([0.0, 0.0, 0.0, 0.6, 0.0])  # to the left nothing is seen
    camera = CameraModel(Intrinsics(lens, folded, (640, 480)), np.eye(4))
    camera.ray(333.5, 243.5)
    with pytest.raises(BadValueError, match="nearer to the centre"):
        camera.ray(0, 243.5)
