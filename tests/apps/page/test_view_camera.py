"""Pixels and points: projecting and going back are exact inverses, for every camera."""

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
def test_what_is_unprojected_projects_to_the_same_pixel_and_depth(camera, px, depth_m):
    back, depth_back = camera.project(camera.unproject(px, depth_m))
    assert np.abs(back - px).max() < 1e-9 * max(1.0, np.abs(px).max())
    assert depth_back == pytest.approx(depth_m, abs=1e-12)


@laws
@given(cameras, points)
def test_what_is_projected_unprojects_to_the_same_point(camera, point):
    px, depth_m = camera.project(point)
    np.testing.assert_allclose(camera.unproject(px, depth_m), point, atol=1e-9)


@laws
@given(cameras, pixels, depths)
def test_every_point_of_a_line_of_sight_is_at_its_pixel(camera, px, depth_m):
    ray = camera.ray(px)
    way_m = depth_m / float(ray.direction @ camera.forward)
    seen, seen_depth = camera.project(ray.at(way_m))
    assert np.abs(seen - px).max() < 1e-9 * max(1.0, np.abs(px).max(), 1.0 / depth_m)
    assert seen_depth == pytest.approx(depth_m)


@laws
@given(cameras, pixels, depths, st.floats(-300, 300), st.floats(-300, 300))
def test_a_vector_in_pixels_is_a_vector_parallel_to_the_screen(camera, px, depth_m, dx, dy):
    there = camera.unproject(px, depth_m) + camera.shift((dx, dy), depth_m)
    moved, moved_depth = camera.project(there)
    np.testing.assert_allclose(moved, px + np.array([dx, dy]), atol=1e-6)
    assert moved_depth == pytest.approx(depth_m)


@laws
@given(cameras, pixels, depths)
def test_a_metre_is_as_many_pixels_as_the_camera_says(camera, px, depth_m):
    ends = camera.unproject(px, depth_m) + np.array([np.zeros(3), 0.01 * camera.right])
    (a, b), _ = camera.project(ends)
    expected = 0.01 * camera.pixels_per_metre(depth_m)
    assert np.hypot(*(b - a)) == pytest.approx(expected, rel=1e-6)


@laws
@given(cameras, points)
def test_many_points_project_as_each_alone(camera, point):
    px, depth_m = camera.project(np.array([point, point + 1.0]))
    alone_px, alone_depth = camera.project(point)
    np.testing.assert_allclose(px[0], alone_px, atol=1e-9)
    assert depth_m[0] == pytest.approx(alone_depth)


@pytest.mark.parametrize("size", [(0.0, 100.0), (100.0, -1.0), (1e9, 100.0), (float("nan"), 1.0)])
def test_a_viewport_of_no_size_is_refused(size):
    with pytest.raises(BadValueError):
        Viewport(*size)


@pytest.mark.parametrize("ratio", [0.0, 100.0, float("nan")])
def test_an_absurd_pixel_ratio_is_refused(ratio):
    with pytest.raises(BadValueError):
        Viewport(100.0, 100.0, ratio)


@pytest.mark.parametrize("view", ["side", "top", "front", "orbit"])
@pytest.mark.parametrize("name", ["so101", "wx250s", "open_manipulator_x"])
def test_the_whole_arm_is_in_the_picture_at_home(name, view):
    chain, home = model_of(name).chain, stage(name).home
    links_m = [T[:3, 3] for T in chain.link_poses(home).values()]
    px, depth_m = looked_at(name, view).project(np.array(links_m))
    assert (px > 0).all()
    assert (px < (VIEWPORT.width_px, VIEWPORT.height_px)).all()
    assert (depth_m > 0).all()


def test_from_the_side_up_is_up_and_the_arm_points_to_the_right():
    camera = looked_at("so101", "side")
    base, tip = camera.project(np.array([[0.0, 0.0, 0.0], [0.25, 0.0, 0.15]]))[0]
    assert tip[0] > base[0]
    assert tip[1] < base[1]


def test_from_the_front_the_arm_points_at_the_person():
    _, (base, tip) = looked_at("so101", "front").project(np.array([[0.0] * 3, [0.25, 0, 0.15]]))
    assert tip < base


@pytest.mark.parametrize("turn_rad", [-1.2, 0.0, 0.4, 1.5])
def test_the_side_view_turns_with_the_arm(turn_rad):
    chain, home = model_of("so101").chain, stage("so101").home
    q = home + turn_rad * np.eye(chain.dof)[0]
    at_home = looked_at("so101", "side").project(chain.forward(home)[:3, 3])[0]
    turned = looked_at("so101", "side", q).project(chain.forward(q)[:3, 3])[0]
    np.testing.assert_allclose(turned, at_home, atol=1e-3)


def test_a_flat_arm_is_seen_along_its_axes():
    camera = looked_at("planar3", "plane")
    np.testing.assert_allclose(np.abs(camera.forward), (0, 0, 1), atol=1e-9)


def test_panning_moves_what_is_at_that_depth_by_as_many_pixels():
    view, the_stage = Viewpoint("orbit"), stage("so101")
    camera = make_camera(the_stage, view, VIEWPORT, 0.0)
    point = np.array([0.1, 0.0, 0.1])
    before, depth_m = camera.project(point)
    moved = make_camera(the_stage, view.pan_by((30.0, -12.0), camera, depth_m), VIEWPORT, 0.0)
    np.testing.assert_allclose(moved.project(point)[0] - before, (30.0, -12.0), atol=1e-6)


@laws
@given(st.lists(st.tuples(st.floats(-9, 9), st.floats(-9, 9)), max_size=6))
def test_an_orbit_never_goes_over_the_top(turns):
    view = Viewpoint("orbit")
    for yaw_rad, pitch_rad in turns:
        view = view.orbit_by(yaw_rad, pitch_rad)
    assert make_camera(stage("so101"), view, VIEWPORT, 0.0).up[2] > 0


@pytest.mark.parametrize("view", ["side", "top", "orbit"])
def test_zooming_makes_everything_larger(view):
    ends = np.array([[0.2, 0.0, 0.1], [0.2, 0.03, 0.13]])
    sizes = [
        np.hypot(
            *np.diff(make_camera(stage("so101"), v, VIEWPORT, 0.5).project(ends)[0], axis=0)[0]
        )
        for v in (Viewpoint(view), Viewpoint(view).zoom_by(2.0))
    ]
    assert sizes[1] > 1.5 * sizes[0]
