"""Picking: the nearest link under a pixel, against rays marched through every shape."""

import time

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from ikservo.apps.page.picking.bvh import capsule_rows, link_primitives, triangle_rows
from ikservo.apps.page.picking.link_poses import link_poses
from ikservo.apps.page.picking.picking import Picker
from ikservo.apps.page.picking.projection import NEAR_PLANE_M
from ikservo.apps.page.picking.raycast import raycast_brute_force
from ikservo.kinematics.capsules import segment_distance
from ikservo.kinematics.se3 import exp_so3, make_pose
from ikservo.model.collision_model import capsules_of
from tests.apps.page.view_fixtures import (
    VIEWPORT,
    cameras,
    looked_at,
    model_of,
    picker,
    points,
    stage,
)

VIEWS = ["side", "top", "front", "orbit"]
laws = settings(max_examples=25, deadline=None)


def cloud(random, count, kind):
    """Return so many random shapes in a box of two metres, as rows."""
    size = 0.6 / count ** (1 / 3)
    middles = random.uniform(-1, 1, (count, 3))
    if kind == "triangles":
        return triangle_rows(middles[:, None] + size * random.normal(size=(count, 3, 3)))
    ways = size * random.normal(size=(count, 3)) * (kind == "capsules")
    return capsule_rows(middles, middles + ways, size * random.uniform(0.1, 0.5, count))


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


def in_world(rows, T):
    """Return capsules and triangles moved to where their link is."""
    moved = rows.copy()
    for columns in (slice(1, 4), slice(4, 7), slice(7, 10)):
        moved[:, columns] = rows[:, columns] @ T[:3, :3].T + T[:3, 3]
    capsules = rows[:, 0] == 0.0
    moved[capsules, 7:] = rows[capsules, 7:]
    return moved


@pytest.mark.parametrize("kind", ["capsules", "balls", "triangles"])
@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 120))
def test_boxes_find_what_looking_at_every_shape_finds(kind, seed, count):
    random = np.random.default_rng(seed)
    shapes = {link: cloud(random, count, kind) for link in ("a", "b", "c")}
    poses, (origins, directions) = places(random, shapes), rays_at(random, 20)
    ways, _ = Picker(shapes).cast(origins, directions, poses)
    nearest = np.empty(2)
    for i, link in enumerate(shapes):
        rows = in_world(shapes[link], poses[link])
        for k in range(len(origins)):
            raycast_brute_force(origins[k], directions[k], rows, nearest)
            assert ways[k, i] == pytest.approx(nearest[0], abs=1e-9)


@laws
@given(points, points, st.floats(0.02, 0.5), st.integers(0, 2**32 - 1))
def test_a_ray_meets_a_capsule_where_it_first_comes_as_near_as_its_radius(a, b, radius_m, seed):
    (origin,), (direction,) = rays_at(np.random.default_rng(seed), 1)
    assume(segment_distance(origin, origin, a, b) > radius_m)
    rows = capsule_rows(a[None], b[None], np.array([radius_m]))
    ways, _ = Picker({"x": rows}).cast(origin[None], direction[None], {"x": np.eye(4)})
    way = ways[0, 0]
    if np.isinf(way):
        assert segment_distance(origin, origin + 20 * direction, a, b) >= radius_m - 1e-6
    else:
        met = origin + way * direction
        assert segment_distance(met, met, a, b) == pytest.approx(radius_m, abs=1e-7)
        assert segment_distance(origin, met, a, b) >= radius_m - 1e-6


@laws
@given(points, points, points, st.integers(0, 2**32 - 1))
def test_a_ray_meets_a_triangle_where_its_own_plane_and_sides_say(a, b, c, seed):
    (origin,), (direction,) = rays_at(np.random.default_rng(seed), 1)
    normal = np.cross(b - a, c - a)
    assume(np.linalg.norm(normal) > 1e-2 and abs(normal @ direction) > 1e-2)
    way = float((a - origin) @ normal / (direction @ normal))
    corners, met = np.vstack([np.array([a, b, c]).T, np.ones(3)]), origin + way * direction
    shares = np.linalg.lstsq(corners, np.append(met, 1.0), rcond=None)[0]
    assume(way > 0 and np.abs(shares).min() > 1e-6)
    rows = triangle_rows(np.array([[a, b, c]]))
    ways, _ = Picker({"x": rows}).cast(origin[None], direction[None], {"x": np.eye(4)})
    assert ways[0, 0] == pytest.approx(way if shares.min() > 0 else np.inf, abs=1e-6)


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("name", ["so101", "wx250s", "open_manipulator_x"])
def test_the_middle_of_a_capsule_in_view_picks_its_own_link(name, view):
    """What hides it, where anything does, is nearer: never something behind."""
    home = stage(name).home
    poses, camera = link_poses(model_of(name).chain, home, {}), looked_at(name, view)
    seen = 0
    for capsule in capsules_of(model_of(name)):
        a, b = capsule.ends(poses[capsule.link])
        px, depth_m = camera.project(0.5 * (a + b))
        hit = picker(name).pick_at(camera, poses, px)
        assert hit.link == capsule.link or hit.depth_m < depth_m
        seen += hit.link == capsule.link
    assert seen > 5


@laws
@given(st.integers(0, 2**32 - 1), st.sampled_from(VIEWS))
def test_a_visible_point_of_a_link_picks_that_link_at_that_very_point(seed, view):
    random, chain = np.random.default_rng(seed), model_of("so101").chain
    q = random.uniform(chain.lower_rad, chain.upper_rad)
    poses, camera = link_poses(chain, q, {}), looked_at("so101", view, q)
    capsule = random.choice(capsules_of(model_of("so101")))
    a, b = capsule.ends(poses[capsule.link])
    hit = picker("so101").pick_at(
        camera, poses, camera.project(a + random.random() * (b - a))[0], 1
    )
    np.testing.assert_allclose(chain.forward(q, hit.link, hit.offset_m)[:3, 3], hit.point_m,
                               atol=1e-12)  # fmt: skip
    px, depth_m = camera.project(hit.point_m)
    again = picker("so101").pick_at(camera, poses, px, 1)
    assert again.link == hit.link
    assert again.depth_m == pytest.approx(depth_m, abs=1e-9)


@laws
@given(cameras, st.integers(0, 2**32 - 1))
def test_hits_come_nearest_first(camera, seed):
    random = np.random.default_rng(seed)
    shapes = {link: cloud(random, 10, "capsules") for link in "abcd"}
    hits = Picker(shapes).pick_all_at(camera, places(random, shapes), camera.viewport.centre_px)
    depths = [hit.depth_m for hit in hits]
    assert depths == sorted(depths)


def ball_beside_the_pointer(away_px, behind=()):
    """Return what is picked at the middle when a ball of 10 px begins so far to the right."""
    camera = looked_at("so101", "top")
    middle = VIEWPORT.centre_px
    centre = camera.unproject(middle + np.array([away_px + 10.0, 0.0]), 9.0)
    radius_m = 10.0 / camera.scale_px
    rows = {"ball": capsule_rows(centre[None], centre[None], np.array([radius_m]))}
    for name, depth_m in behind:
        wall = camera.unproject(middle, depth_m)[None]
        rows[name] = capsule_rows(wall, wall, np.array([0.05]))
    return Picker(rows), camera, {link: np.eye(4) for link in rows}, middle


def test_a_link_within_two_pixels_of_the_pointer_is_picked():
    thing, camera, poses, px = ball_beside_the_pointer(1.9)
    assert thing.pick_at(camera, poses, px).link == "ball"


def test_a_link_three_pixels_away_is_not():
    thing, camera, poses, px = ball_beside_the_pointer(3.1)
    assert thing.pick_at(camera, poses, px) is None


def test_what_is_right_under_the_pointer_is_preferred_to_what_is_nearer_beside_it():
    thing, camera, poses, px = ball_beside_the_pointer(1.5, behind=[("wall", 9.5)])
    assert thing.pick_at(camera, poses, px).link == "wall"


def test_all_that_is_near_the_pointer_is_listed_by_depth():
    thing, camera, poses, px = ball_beside_the_pointer(1.5, [("far", 9.9), ("near", 9.5)])
    assert [hit.link for hit in thing.pick_all_at(camera, poses, px)] == ["ball", "near", "far"]


# --- the square around the pointer, exactly ---

AROUND = [np.array([u, v]) for u in np.linspace(-2.3, 2.3, 7) for v in np.linspace(-2.3, 2.3, 7)]


def wire_at(camera, at_px, width_px, along_px):
    """Return a wire of so many pixels across, from one pixel to another, a metre deep."""
    ends = camera.unproject(at_px + np.array([[0.0, 0.0], along_px]), np.array([1.0, 1.0]))
    radius_m = 0.5 * width_px / float(camera.pixels_per_metre(1.0))
    return Picker({"wire": capsule_rows(ends[:1], ends[1:], np.array([radius_m]))})


@pytest.mark.parametrize("view", ["front", "orbit"])
def test_a_wire_of_half_a_pixel_is_found_all_over_the_square(view):
    camera, middle = looked_at("so101", view), VIEWPORT.centre_px
    missed = [
        tuple(away)
        for away in AROUND
        if not wire_at(camera, middle + away, 0.4, (0.4, 0.0)).pick_all_at(
            camera, {"wire": np.eye(4)}, middle
        )
    ]
    assert missed == []


@pytest.mark.parametrize("view", ["front", "orbit"])
@pytest.mark.parametrize(("away_px", "hit"), [(2.69, True), (2.71, False)])
def test_a_wire_is_found_exactly_where_its_edge_is_in_the_square(view, away_px, hit):
    """The square ends 2.5 px from the pointer, the wire 0.2 px from its middle."""
    camera, middle = looked_at("so101", view), VIEWPORT.centre_px
    for side in (np.array([away_px, 0.3]), np.array([0.3, -away_px])):
        thing = wire_at(camera, middle + side, 0.4, side)
        assert bool(thing.pick_all_at(camera, {"wire": np.eye(4)}, middle)) == hit


def rays_in_square(thing, camera, poses, px, half_px, count):
    """Return how far from the pointer links are that rays all over a square meet."""
    steps = np.linspace(-half_px, half_px, count)
    offsets = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    ways, _ = thing.cast(*camera.rays(px + offsets), poses)
    met = np.where(np.isfinite(ways), np.abs(offsets).max(axis=1)[:, None], np.inf)
    return dict(zip(poses, met.min(axis=0).tolist(), strict=True))


@pytest.mark.parametrize("kind", ["capsules", "balls", "triangles"])
@settings(max_examples=25, deadline=None)
@given(cameras, st.integers(0, 2**32 - 1))
def test_the_square_holds_whatever_any_ray_in_it_meets(kind, camera, seed):
    random, half_px, count = np.random.default_rng(seed), 40.0, 41
    shapes = {link: cloud(random, 12, kind) for link in "abcdef"}
    thing, poses, px = Picker(shapes), places(random, shapes), camera.viewport.centre_px + 30.0
    rays = rays_in_square(thing, camera, poses, px, half_px, count)
    hits = {hit.link: hit for hit in thing.pick_all_at(camera, poses, px, 2 * half_px)}
    for link, away_px in rays.items():
        if np.isfinite(away_px):
            assert hits[link].away_px <= away_px + 1e-6


@pytest.mark.parametrize("kind", ["capsules", "balls", "triangles"])
@settings(max_examples=25, deadline=None)
@given(cameras, st.integers(0, 2**32 - 1))
def test_what_is_found_beside_the_pointer_is_seen_at_that_very_place(kind, camera, seed):
    """A ray a thousandth of the way further into the shape meets it, if the eye is before it."""
    random, half_px = np.random.default_rng(seed), 60.0
    shapes = {link: cloud(random, 3, kind) for link in "abcdef"}
    thing, poses, px = Picker(shapes), places(random, shapes), camera.viewport.centre_px - 20.0
    for hit in thing.pick_all_at(camera, poses, px, 2 * half_px):
        at_px, depth_m = camera.project(hit.point_m)
        assert hit.away_px <= half_px
        assert depth_m == pytest.approx(hit.depth_m, abs=1e-9)
        if depth_m >= NEAR_PLANE_M:  # nothing is drawn nearer to the eye, nor projected truly
            assert np.abs(at_px - px).max() == pytest.approx(hit.away_px, abs=1e-5)
        row = in_world(shapes[hit.link], poses[hit.link])[hit.shape]
        corners = row[1:10].reshape(3, 3)[: 3 if kind == "triangles" else 2]
        middle_px, _ = camera.project(corners.mean(axis=0))
        if camera.depth_of(corners).min() > 0.5:
            ways, _ = thing.cast(*camera.rays([at_px + 1e-3 * (middle_px - at_px)]), poses)
            assert np.isfinite(ways[0, list(shapes).index(hit.link)])


def test_a_triangle_seen_from_its_edge_is_found():
    camera, middle = looked_at("so101", "front"), VIEWPORT.centre_px
    corners = camera.unproject(
        middle + np.array([[1.0, -9.0], [1.0, 9.0], [1.0, 9.0]]), np.array([1.0, 1.0, 2.0])
    )
    thing = Picker({"sheet": triangle_rows(corners[None])})
    (hit,) = thing.pick_all_at(camera, {"sheet": np.eye(4)}, middle)
    assert hit.away_px == pytest.approx(1.0)


def test_what_is_behind_the_eye_is_not_in_the_square():
    camera = looked_at("so101", "orbit")
    behind = camera.eye_m - 0.5 * camera.forward
    rows = capsule_rows(behind[None], behind[None] + 0.1, np.array([0.05]))
    assert Picker({"x": rows}).pick_all_at(camera, {"x": np.eye(4)}, VIEWPORT.centre_px, 500) == ()


def test_the_square_is_looked_at_in_a_fraction_of_a_frame():
    camera, home = looked_at("wx250s", "orbit"), stage("wx250s").home
    poses = link_poses(model_of("wx250s").chain, home, {})
    px = camera.project(poses["wrist"][:3, 3])[0]

    def view_state():
        picker("wx250s").pick_all_at(camera, poses, px, 41)

    view_state()
    assert min(_seconds(view_state) for _ in range(20)) < 0.004


def test_over_empty_space_nothing_is_picked():
    camera, poses = looked_at("so101", "side"), link_poses(model_of("so101").chain,
                                                           stage("so101").home, {})  # fmt: skip
    assert picker("so101").pick_at(camera, poses, (5.0, 5.0)) is None


def test_an_arm_without_shapes_can_be_looked_at():
    camera = looked_at("so101", "side")
    assert Picker({}).pick_all_at(camera, {}, (5.0, 5.0)) == ()


def test_a_jaw_is_picked_where_it_is_opened_to():
    model, camera = model_of("so101"), looked_at("so101", "side")
    poses = link_poses(model.chain, stage("so101").home, {"gripper": 1.2})
    jaw = next(c for c in capsules_of(model) if c.link == "jaw")
    a, b = jaw.ends(poses["jaw"])
    hits = picker("so101").pick_all_at(camera, poses, camera.project(0.5 * (a + b))[0])
    assert "jaw" in [hit.link for hit in hits]


@pytest.mark.parametrize("kind", ["capsules", "triangles"])
@pytest.mark.parametrize("count", [1000, 10_000])
def test_boxes_leave_out_nearly_all_shapes(kind, count):
    """One in twenty of a thousand shapes; the more there are, the smaller the share."""
    random = np.random.default_rng(7)
    thing = Picker({"x": cloud(random, count, kind)})
    origins, directions = rays_at(random, 200)
    thing.cast(origins, directions, {"x": np.eye(4)})
    assert thing.tested / len(origins) < 50.0


def test_the_arms_own_shapes_stay_where_the_link_puts_them():
    model = model_of("so101")
    rows = link_primitives(capsules_of(model))
    assert set(rows) == {capsule.link for capsule in capsules_of(model)}
    assert sum(map(len, rows.values())) == len(capsules_of(model))


def test_boxes_are_faster_than_looking_at_a_thousand_shapes():
    """Ten times is usual; both are timed in turn and the best of several runs is taken."""
    random = np.random.default_rng(3)
    rows = cloud(random, 1000, "capsules")
    thing, (origins, directions), nearest = Picker({"x": rows}), rays_at(random, 100), np.empty(2)

    def through_boxes():
        thing.cast(origins, directions, {"x": np.eye(4)})

    def through_all():
        for origin, direction in zip(origins, directions, strict=True):
            raycast_brute_force(origin, direction, rows, nearest)

    times = [[_seconds(run) for run in (through_boxes, through_all)] for _ in range(7)]
    boxes_s, all_s = np.min(times, axis=0)
    assert all_s > 2 * boxes_s


def _seconds(run):
    began = time.thread_time()
    run()
    return time.thread_time() - began
