"""Picking finds the nearest link under a pixel, compared with points along the rays."""

import time

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from ikservo.apps.page.picking.link_poses import link_poses
from ikservo.apps.page.picking.picking import Picker
from ikservo.apps.page.picking.projection import NEAR_PLANE_M
from ikservo.apps.page.picking.raycast import (
    PickShape,
    capsule_shape,
    cast_rays,
    link_shapes,
    thing_shapes,
)
from ikservo.kinematics.capsules import segment_distance
from ikservo.kinematics.se3 import exp_so3, make_pose
from ikservo.model.arm_model import KeepOutBox
from ikservo.model.collision_capsules import capsules_of
from tests.apps.page.view_fixtures import (
    VIEWPORT,
    cameras,
    looked_at,
    model_of,
    picker,
    points,
    selected,
    stage,
)

VIEWS = ["side", "top", "front", "orbit"]
KINDS = ["capsules", "balls", "boxes"]
laws = settings(max_examples=25, deadline=None)


def cloud(random, count, kind):
    """Return random capsules (count, 7) in a box of two metres; balls have no length."""
    size = 0.6 / count ** (1 / 3)
    middles = random.uniform(-1, 1, (count, 3))
    ways = size * random.normal(size=(count, 3)) * (kind == "capsules")
    return np.column_stack([middles, middles + ways, size * random.uniform(0.1, 0.5, count)])


def random_shape(random, count, kind):
    if kind != "boxes":
        return capsule_shape(cloud(random, count, kind))
    return PickShape(np.sort(random.uniform(-0.4, 0.4, (2, 3)), axis=0))


def one_capsule(start_m, end_m, radius_m):
    return capsule_shape(np.array([[*start_m, *end_m, radius_m]]))


def rays_at(random, count):
    """Return rays from around the box into it."""
    origins = random.normal(size=(count, 3))
    origins *= 4.0 / np.linalg.norm(origins, axis=1)[:, None]
    directions = random.uniform(-1, 1, (count, 3)) - origins
    return origins, directions / np.linalg.norm(directions, axis=1)[:, None]


def places(random, links):
    return {
        link: make_pose(random.uniform(-1, 1, 3), exp_so3(random.normal(size=3))) for link in links
    }


def in_world(capsules, T):
    """Return the shapes of single capsules (n, 7) where their link is, by number."""
    R, p = T[:3, :3], T[:3, 3]
    return {
        str(i): one_capsule(R @ row[:3] + p, R @ row[3:6] + p, row[6])
        for i, row in enumerate(capsules)
    }


def cast_one(shape, origin, direction):
    """Return the distance along one ray to a shape in the base frame."""
    return float(cast_rays({"x": shape}, {"x": np.eye(4)}, origin[None], direction[None])[0, 0])


@pytest.mark.parametrize("kind", ["capsules", "balls"])
@laws
@given(st.integers(0, 2**32 - 1), st.integers(1, 40))
def test_pick_ray_meets_link_at_its_first_capsule(kind, seed, count):
    random = np.random.default_rng(seed)
    clouds = {link: cloud(random, count, kind) for link in ("a", "b", "c")}
    shapes = {link: capsule_shape(rows) for link, rows in clouds.items()}
    poses, rays = places(random, shapes), rays_at(random, 20)
    ways = cast_rays(shapes, poses, *rays)
    for i, link in enumerate(shapes):
        single = in_world(clouds[link], poses[link])
        each = cast_rays(single, dict.fromkeys(single, np.eye(4)), *rays)
        np.testing.assert_allclose(ways[:, i], each.min(axis=1), atol=1e-9)


@laws
@given(points, points, st.floats(0.02, 0.5), st.integers(0, 2**32 - 1))
def test_pick_ray_meets_capsule_at_its_radius(a, b, radius_m, seed):
    (origin,), (direction,) = rays_at(np.random.default_rng(seed), 1)
    assume(segment_distance(origin, origin, a, b) > radius_m)
    way = cast_one(one_capsule(a, b, radius_m), origin, direction)
    if np.isinf(way):
        assert segment_distance(origin, origin + 20 * direction, a, b) >= radius_m - 1e-6
    else:
        met = origin + way * direction
        assert segment_distance(met, met, a, b) == pytest.approx(radius_m, abs=1e-7)
        assert segment_distance(origin, met, a, b) >= radius_m - 1e-6


def test_pick_ray_along_capsule_axis_meets_its_end():
    x = np.array([1.0, 0.0, 0.0])
    assert cast_one(one_capsule(x, 2 * x, 0.1), np.zeros(3), x) == pytest.approx(0.9)


def test_pick_ray_misses_capsule_around_or_behind_its_origin():
    x = np.array([1.0, 0.0, 0.0])
    for start in (0.0, 0.5, 1.0, 1.09, 1.2):
        assert cast_one(one_capsule(0 * x, x, 0.1), start * x, x) == np.inf


@laws
@given(points, points, st.integers(0, 2**32 - 1))
def test_pick_ray_meets_box_at_nearest_face(a, b, seed):
    (origin,), (direction,) = rays_at(np.random.default_rng(seed), 1)
    low, high = np.minimum(a, b), np.maximum(a, b)
    assume(np.ptp([low, high], axis=0).min() > 0.01)
    (shape,) = thing_shapes([KeepOutBox("x", tuple(low), tuple(high))]).values()
    walls = [(axis, at[axis]) for axis in range(3) for at in (low, high)]
    ways = [(at - origin[axis]) / direction[axis] for axis, at in walls]
    met = [
        way
        for way in ways
        if way >= 0 and (np.abs(origin + way * direction - 0.5 * (low + high))
                         <= 0.5 * (high - low) + 1e-9).all()
    ]  # fmt: skip
    assert cast_one(shape, origin, direction) == pytest.approx(min(met, default=np.inf))


def test_pick_ray_starting_in_box_meets_its_face():
    x = np.array([1.0, 0.0, 0.0])
    assert cast_one(PickShape(np.array([-np.ones(3), np.ones(3)])), 0.25 * x, x) == 0.75


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("name", ["so101", "wx250s", "open_manipulator_x"])
def test_middle_of_visible_capsule_picks_its_link(name, view):
    """If another link hides it, that one is nearer; never one behind it."""
    home = stage(name).home
    poses, camera = link_poses(model_of(name).chain, home, {}), looked_at(name, view)
    seen = 0
    for capsule in capsules_of(model_of(name)):
        a, b = capsule.ends(poses[capsule.link])
        px, depth_m = camera.project(0.5 * (a + b))
        hit = selected(picker(name).pick_all_at(camera, poses, px))
        assert hit.link == capsule.link or hit.depth_m < depth_m
        seen += hit.link == capsule.link
    assert seen > 5


@laws
@given(st.integers(0, 2**32 - 1), st.sampled_from(VIEWS))
def test_visible_point_of_link_picks_that_link_and_point(seed, view):
    random, chain = np.random.default_rng(seed), model_of("so101").chain
    q = random.uniform(chain.lower_rad, chain.upper_rad)
    poses, camera = link_poses(chain, q, {}), looked_at("so101", view, q)
    capsule = random.choice(capsules_of(model_of("so101")))
    a, b = capsule.ends(poses[capsule.link])
    px, _ = camera.project(a + random.random() * (b - a))
    hit = selected(picker("so101").pick_all_at(camera, poses, px, 1))
    np.testing.assert_allclose(chain.forward(q, hit.link, hit.offset_m)[:3, 3], hit.point_m,
                               atol=1e-12)  # fmt: skip
    px, depth_m = camera.project(hit.point_m)
    again = selected(picker("so101").pick_all_at(camera, poses, px, 1))
    assert again.link == hit.link
    assert again.depth_m == pytest.approx(depth_m, abs=1e-9)


@laws
@given(cameras, st.integers(0, 2**32 - 1))
def test_pick_hits_are_sorted_nearest_first(camera, seed):
    random = np.random.default_rng(seed)
    shapes = {link: random_shape(random, 10, "capsules") for link in "abcd"}
    hits = Picker(shapes).pick_all_at(camera, places(random, shapes), camera.viewport.centre_px)
    depths = [hit.depth_m for hit in hits]
    assert depths == sorted(depths)


def ball_beside_the_pointer(away_px, behind=()):
    """Return the item picked at the centre when a ball of 10 px begins that far to the right."""
    camera = looked_at("so101", "top")
    middle = VIEWPORT.centre_px
    centre = camera.unproject(middle + np.array([away_px + 10.0, 0.0]), 9.0)
    shapes = {"ball": one_capsule(centre, centre, 10.0 / camera.scale_px)}
    for name, depth_m in behind:
        wall = camera.unproject(middle, depth_m)
        shapes[name] = one_capsule(wall, wall, 0.05)
    return Picker(shapes).pick_all_at(camera, {link: np.eye(4) for link in shapes}, middle)


def test_a_link_within_two_pixels_of_the_pointer_is_picked():
    assert selected(ball_beside_the_pointer(1.9)).link == "ball"


def test_link_three_pixels_from_pointer_is_not_picked():
    assert ball_beside_the_pointer(3.1) == ()


def test_link_under_pointer_has_priority_over_nearer_neighbour():
    assert selected(ball_beside_the_pointer(1.5, behind=[("wall", 9.5)])).link == "wall"


def test_links_near_pointer_are_listed_by_depth():
    hits = ball_beside_the_pointer(1.5, [("far", 9.9), ("near", 9.5)])
    assert [hit.link for hit in hits] == ["ball", "near", "far"]


# --- the square around the pointer ---

AROUND = [np.array([u, v]) for u in np.linspace(-2.3, 2.3, 7) for v in np.linspace(-2.3, 2.3, 7)]


@pytest.mark.parametrize("view", ["front", "orbit"])
@pytest.mark.parametrize("along_px", [(90.0, 0.0), (0.0, 90.0), (60.0, 60.0), (80.0, -30.0)])
def test_one_pixel_wide_link_is_found_within_pick_tolerance(view, along_px):
    camera, middle, along = looked_at("so101", view), VIEWPORT.centre_px, np.array(along_px)
    radius_m = 0.5 / float(camera.pixels_per_metre(1.0))
    for away in AROUND:
        ends = camera.unproject(middle + away + np.array([-along, along]), np.ones(2))
        wire = Picker({"wire": one_capsule(*ends, radius_m)})
        assert wire.pick_all_at(camera, {"wire": np.eye(4)}, middle)


@pytest.mark.parametrize("kind", KINDS)
@laws
@given(cameras, st.integers(0, 2**32 - 1))
def test_pick_hit_projects_to_pixel_where_it_was_found(kind, camera, seed):
    """The ray through the pixel of a hit meets the link at the same point."""
    random, half_px = np.random.default_rng(seed), 20.0
    shapes = {link: random_shape(random, 3, kind) for link in "abcdef"}
    poses, px = places(random, shapes), camera.viewport.centre_px - 20.0
    for hit in Picker(shapes).pick_all_at(camera, poses, px, 2 * half_px):
        at_px, depth_m = camera.project(hit.point_m)
        assert hit.away_px <= half_px
        assert depth_m == pytest.approx(hit.depth_m, abs=1e-9)
        if depth_m >= NEAR_PLANE_M:  # nothing is drawn nearer to the eye, nor projected truly
            assert np.abs(at_px - px).max() == pytest.approx(hit.away_px, abs=1e-5)


@pytest.mark.parametrize("kind", KINDS)
@laws
@given(cameras, st.integers(0, 2**32 - 1))
def test_pick_returns_pixel_of_link_nearest_to_pointer(kind, camera, seed):
    """No ray of a coarser grid over the square meets the link nearer to the pointer."""
    random, half_px = np.random.default_rng(seed), 20.0
    shapes = {link: random_shape(random, 12, kind) for link in "abcdef"}
    poses, px = places(random, shapes), camera.viewport.centre_px + 30.0
    steps = np.arange(-half_px, half_px + 1, 2.0)
    offsets = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    ways = cast_rays(shapes, poses, *camera.rays(px + offsets))
    away_px = np.where(np.isfinite(ways), np.abs(offsets).max(axis=1)[:, None], np.inf).min(axis=0)
    hits = {hit.link: hit for hit in Picker(shapes).pick_all_at(camera, poses, px, 2 * half_px)}
    for link, nearest_px in zip(shapes, away_px, strict=True):
        if np.isfinite(nearest_px):
            assert hits[link].away_px <= nearest_px


def test_obstacle_behind_camera_is_not_picked():
    camera = looked_at("so101", "orbit")
    behind = camera.eye_m - 0.5 * camera.forward
    thing = Picker({"x": one_capsule(behind, behind + 0.1, 0.05)})
    assert thing.pick_all_at(camera, {"x": np.eye(4)}, VIEWPORT.centre_px, 500) == ()


def test_pick_takes_less_than_4_ms():
    camera, home = looked_at("wx250s", "orbit"), stage("wx250s").home
    poses = link_poses(model_of("wx250s").chain, home, {})
    px = camera.project(poses["wrist"][:3, 3])[0]

    def view_state():
        picker("wx250s").pick_all_at(camera, poses, px)

    view_state()
    assert min(_seconds(view_state) for _ in range(20)) < 0.004


def _seconds(run):
    began = time.thread_time()
    run()
    return time.thread_time() - began


def test_pick_over_empty_space_finds_nothing():
    camera, poses = looked_at("so101", "side"), link_poses(model_of("so101").chain,
                                                           stage("so101").home, {})  # fmt: skip
    assert picker("so101").pick_all_at(camera, poses, (5.0, 5.0)) == ()


def test_arm_without_shapes_is_picked_without_error():
    camera = looked_at("so101", "side")
    assert Picker({}).pick_all_at(camera, {}, (5.0, 5.0)) == ()


def test_jaw_is_picked_at_its_opened_position():
    model, camera = model_of("so101"), looked_at("so101", "side")
    poses = link_poses(model.chain, stage("so101").home, {"gripper": 1.2})
    jaw = next(c for c in capsules_of(model) if c.link == "jaw")
    a, b = jaw.ends(poses["jaw"])
    hits = picker("so101").pick_all_at(camera, poses, camera.project(0.5 * (a + b))[0])
    assert "jaw" in [hit.link for hit in hits]


def test_pick_shapes_contain_every_capsule_of_each_link():
    capsules = capsules_of(model_of("so101"))
    shapes = link_shapes(capsules)
    assert set(shapes) == {capsule.link for capsule in capsules}
    assert sum(len(shape.capsules) for shape in shapes.values()) == len(capsules)
