"""Projection to pixels and back is exact for every camera."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ikservo.apps.page.picking.projection import Viewport
from ikservo.apps.page.picking.viewpoints import Viewpoint, make_camera
from ikservo.errors import BadValueError
from tests.apps.page.view_fixtures import VIEWPORT, cameras, looked_at, model_of, points, stage

depths = st.floats(0.05, 20.0)
pixels = st.tuples(st.floats(-4000, 8000), st.floats(-4000, 8000)).map(np.array)
laws = settings(max_examples=30, deadline=None)


@laws
@given(cameras, pixels, depths)
def test_unprojected_pixel_projects_back_with_same_depth(camera, px, depth_m):
    back, depth_back = camera.project(camera.unproject(px, depth_m))
    assert np.abs(back - px).max() < 1e-9 * max(1.0, np.abs(px).max())
    assert depth_back == pytest.approx(depth_m, abs=1e-12)


@laws
@given(cameras, points)
def test_projected_point_unprojects_to_same_point(camera, point):
    px, depth_m = camera.project(point)
    np.testing.assert_allclose(camera.unproject(px, depth_m), point, atol=1e-9)


@laws
@given(cameras, pixels, depths)
def test_points_on_view_ray_project_to_its_pixel(camera, px, depth_m):
    ray = camera.ray(px)
    way_m = depth_m / float(ray.direction @ camera.forward)
    seen, seen_depth = camera.project(ray.at(way_m))
    assert np.abs(seen - px).max() < 1e-9 * max(1.0, np.abs(px).max(), 1.0 / depth_m)
    assert seen_depth == pytest.approx(depth_m)


@laws
@given(cameras, pixels, depths, st.floats(-300, 300), st.floats(-300, 300))
def test_pixel_shift_moves_point_parallel_to_screen(camera, px, depth_m, dx, dy):
    there = camera.unproject(px, depth_m) + camera.shift((dx, dy), depth_m)
    moved, moved_depth = camera.project(there)
    np.testing.assert_allclose(moved, px + np.array([dx, dy]), atol=1e-6)
    assert moved_depth == pytest.approx(depth_m)


@laws
@given(cameras, pixels, depths)
def test_pixels_per_metre_match_projection(camera, px, depth_m):
    ends = camera.unproject(px, depth_m) + np.array([np.zeros(3), 0.01 * camera.right])
    (a, b), _ = camera.project(ends)
    expected = 0.01 * camera.pixels_per_metre(depth_m)
    assert np.hypot(*(b - a)) == pytest.approx(expected, rel=1e-6)


@laws
@given(cameras, points)
def test_batch_projection_equals_projection_of_each_point(camera, point):
    px, depth_m = camera.project(np.array([point, point + 1.0]))
    alone_px, alone_depth = camera.project(point)
    np.testing.assert_allclose(px[0], alone_px, atol=1e-9)
    assert depth_m[0] == pytest.approx(alone_depth)


@pytest.mark.parametrize("size", [(0.0, 100.0), (100.0, -1.0), (1e9, 100.0), (float("nan"), 1.0)])
def test_viewport_of_invalid_size_is_refused(size):
    with pytest.raises(BadValueError):
        Viewport(*size)


@pytest.mark.parametrize("ratio", [0.0, 100.0, float("nan")])
def test_invalid_pixel_ratio_is_refused(ratio):
    with pytest.raises(BadValueError):
        Viewport(100.0, 100.0, ratio)


@pytest.mark.parametrize("view", ["side", "top", "front", "orbit"])
@pytest.mark.parametrize("name", ["so101", "wx250s", "open_manipulator_x"])
def test_whole_arm_is_visible_in_view_at_home_pose(name, view):
    chain, home = model_of(name).chain, stage(name).home
    links_m = [T[:3, 3] for T in chain.link_poses(home).values()]
    px, depth_m = looked_at(name, view).project(np.array(links_m))
    assert (px > 0).all()
    assert (px < (VIEWPORT.width_px, VIEWPORT.height_px)).all()
    assert (depth_m > 0).all()


def test_side_view_has_up_above_and_arm_pointing_right():
    camera = looked_at("so101", "side")
    base, tip = camera.project(np.array([[0.0, 0.0, 0.0], [0.25, 0.0, 0.15]]))[0]
    assert tip[0] > base[0]
    assert tip[1] < base[1]


def test_front_view_has_arm_pointing_at_viewer():
    _, (base, tip) = looked_at("so101", "front").project(np.array([[0.0] * 3, [0.25, 0, 0.15]]))
    assert tip < base


@pytest.mark.parametrize("turn_rad", [-1.2, 0.0, 0.4, 1.5])
def test_the_side_view_turns_with_the_arm(turn_rad):
    chain, home = model_of("so101").chain, stage("so101").home
    q = home + turn_rad * np.eye(chain.dof)[0]
    at_home = looked_at("so101", "side").project(chain.forward(home)[:3, 3])[0]
    turned = looked_at("so101", "side", q).project(chain.forward(q)[:3, 3])[0]
    np.testing.assert_allclose(turned, at_home, atol=1e-3)


def test_planar_arm_is_seen_along_its_axes():
    camera = looked_at("planar3", "plane")
    np.testing.assert_allclose(np.abs(camera.forward), (0, 0, 1), atol=1e-9)


def test_panning_moves_point_at_given_depth_by_same_pixels():
    view, the_stage = Viewpoint("orbit"), stage("so101")
    camera = make_camera(the_stage, view, VIEWPORT, 0.0)
    point = np.array([0.1, 0.0, 0.1])
    before, depth_m = camera.project(point)
    moved = make_camera(the_stage, view.pan_by((30.0, -12.0), camera, depth_m), VIEWPORT, 0.0)
    np.testing.assert_allclose(moved.project(point)[0] - before, (30.0, -12.0), atol=1e-6)


@laws
@given(st.lists(st.tuples(st.floats(-9, 9), st.floats(-9, 9)), max_size=6))
def test_orbit_camera_never_turns_upside_down(turns):
    view = Viewpoint("orbit")
    for yaw_rad, pitch_rad in turns:
        view = view.orbit_by(yaw_rad, pitch_rad)
    assert make_camera(stage("so101"), view, VIEWPORT, 0.0).up[2] > 0


@pytest.mark.parametrize("view", ["side", "top", "orbit"])
def test_zooming_in_enlarges_drawing(view):
    ends = np.array([[0.2, 0.0, 0.1], [0.2, 0.03, 0.13]])
    sizes = [
        np.hypot(
            *np.diff(make_camera(stage("so101"), v, VIEWPORT, 0.5).project(ends)[0], axis=0)[0]
        )
        for v in (Viewpoint(view), Viewpoint(view).zoom_by(2.0))
    ]
    assert sizes[1] > 1.5 * sizes[0]
