"""The picture: what is drawn is where the camera says, and means what the joints say."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ikservo.kinematics.capsules import Capsule, segment_distance
from ikservo.model.model import KeepOutBox
from ikservo.view.camera import Camera
from ikservo.view.draw_items import TargetMarker, link_poses
from ikservo.view.outlines import SilhouetteRenderer
from ikservo.view.scene import SceneRenderer, SceneState
from ikservo.view.viewpoints import Viewpoint, make_camera
from tests.kinematics.chains import crane
from tests.view.planar_arm import planar_model
from tests.view.view_fixtures import VIEWPORT, looked_at, model_of, picker, scene_renderer, stage

VIEWS = ["side", "top", "front", "orbit"]


def painted(name="so101", view="side", **shown):
    home = stage(name).home
    return scene_renderer(name).draw(
        SceneState(looked_at(name, view), **{"measured": home, **shown})
    )


def of_style(items, *styles):
    return [item for item in items if item["style"] in styles]


def at_joints(**positions):
    """Return the joints of home with some at other positions."""
    chain, q = model_of("so101").chain, stage("so101").home.copy()
    for name, position in positions.items():
        q[chain.names.index(name)] = position
    return q


def arc(items, joint):
    return next(i for i in items if i.get("joint") == joint and i["style"] in
                ("limit", "amber", "red"))  # fmt: skip


# --- the arm ---


AROUND = 1.2 * np.array([(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)])


def inside(ring, px):
    """Return whether a pixel is inside a ring, by the angle it winds round it."""
    arms = np.array(ring) - px
    turns = np.arctan2(arms[:, 1], arms[:, 0])
    return abs(np.sum(np.angle(np.exp(1j * np.diff(np.append(turns, turns[0])))))) > 1.0


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from(VIEWS))
def test_the_outline_of_a_capsule_is_where_lines_of_sight_begin_to_miss_it(seed, view):
    random, camera = np.random.default_rng(seed), looked_at("so101", view)
    a, b = random.uniform(-0.25, 0.25, (2, 3))
    capsule = Capsule("x", a, b, random.uniform(0.005, 0.05))
    ring = SilhouetteRenderer([capsule]).outlines_from(camera, {"x": np.eye(4)})[0].rings[0]
    origins, directions = camera.rays(ring)
    gaps = segment_distance(origins, origins + 20.0 * directions, a, b) / capsule.radius_m
    assert gaps.max() < 1.02
    assert gaps.min() > 0.94


@pytest.mark.parametrize("view", VIEWS)
def test_the_arm_is_drawn_where_it_is_picked(view):
    home, camera = stage("so101").home, looked_at("so101", view)
    drawn = {item["link"]: item["rings"] for item in of_style(painted(view=view), "measured")}
    poses, random = link_poses(model_of("so101").chain, home, {}), np.random.default_rng(2)
    for px in random.uniform((280, 180), (560, 520), (150, 2)):
        for hit in picker("so101").pick_all_at(camera, poses, px, 1):
            rings = drawn[hit.link]
            assert any(inside(ring, px + d) for ring in rings for d in AROUND)


def test_all_outlines_of_a_link_turn_the_same_way_so_that_they_fill_as_one():
    for item in of_style(painted(view="orbit"), "measured"):
        for ring in np.array(item["rings"]):
            x, y = ring.T
            assert x @ np.roll(y, -1) - y @ np.roll(x, -1) < 0


@pytest.mark.parametrize("view", VIEWS)
def test_links_are_painted_from_back_to_front(view):
    camera = looked_at("so101", view)
    home = stage("so101").home
    one_renderer = scene_renderer("so101")
    seen = one_renderer._outlines.outlines_from(camera, link_poses(one_renderer.chain, home, {}))
    assert [o.depth_m for o in seen] == sorted((o.depth_m for o in seen), reverse=True)


def test_a_ghost_is_painted_only_where_the_goal_is_not_where_the_arm_is():
    home = stage("so101").home
    assert not of_style(painted(goal=home), "ghost")
    assert len(of_style(painted(goal=home + 0.1), "ghost")) == 7


def test_the_ghost_is_behind_the_arm():
    styles = [item["style"] for item in painted(goal=stage("so101").home + 0.1)]
    assert max(i for i, s in enumerate(styles) if s == "ghost") < styles.index("measured")


def test_a_link_chosen_behind_others_is_outlined_over_them():
    assert of_style(painted(hover="base"), "behind") == []
    items = painted(hover="base", behind=True)
    (over,) = of_style(items, "behind")
    (under,) = [i for i in items if i.get("link") == "base"]
    assert over["rings"] == under["rings"]
    assert items.index(over) > max(n for n, item in enumerate(items) if item.get("link"))


def test_hovered_and_grabbed_links_are_marked():
    items = painted(hover="forearm", grabbed="wrist")
    assert [i["link"] for i in of_style(items, "hover")] == ["forearm"]
    assert [i["link"] for i in of_style(items, "grabbed")] == ["wrist"]


def test_an_open_jaw_is_drawn_open():
    closed, opened = (
        next(
            i
            for i in of_style(painted(other_joints={"gripper": q}), "measured")
            if i["link"] == "jaw"
        )
        for q in (0.0, 1.0)
    )
    assert closed["rings"] != opened["rings"]


def test_the_tip_is_drawn_where_the_chain_puts_it():
    home = stage("so101").home
    tip = model_of("so101").chain.forward(home)[:3, 3]
    (mark,) = of_style(painted(), "tip")
    np.testing.assert_allclose(mark["at"], looked_at("so101", "side").project(tip)[0], atol=0.06)


# --- ranges ---


def test_every_joint_shows_its_range_as_an_arc_with_a_needle():
    items = painted(view="orbit")
    for joint in model_of("so101").chain.names:
        assert arc(items, joint)["style"] == "limit"
        assert [i for i in of_style(items, "needle") if i["joint"] == joint]


@pytest.mark.parametrize(
    ("room_deg", "style"),
    [(0.0, "red"), (0.2, "red"), (0.5, "amber"), (4.9, "amber"), (5.1, "limit")],
)
@pytest.mark.parametrize("side", ["lower_rad", "upper_rad"])
def test_a_needle_near_its_limit_is_amber_and_at_it_red(side, room_deg, style):
    limit = getattr(model_of("so101").chain, side)[2]
    q = at_joints(elbow_flex=limit + math.radians(room_deg) * (1 if side == "lower_rad" else -1))
    assert arc(painted(measured=q), "elbow_flex")["style"] == style


def test_a_joint_that_is_sent_to_its_limit_is_red_before_it_gets_there():
    goal = at_joints(elbow_flex=float(model_of("so101").chain.upper_rad[2]))
    assert arc(painted(goal=goal), "elbow_flex")["style"] == "red"


def test_the_needle_points_along_the_link_that_the_joint_carries():
    camera, q = looked_at("planar3", "plane"), stage("planar3").home
    chain = model_of("planar3").chain
    needles = {i["joint"]: i["points"] for i in of_style(painted("planar3", "plane"), "needle")}
    pivots = [chain.forward(q, link)[:3, 3] for link in ("upper_arm", "forearm", "hand", "tool")]
    px = camera.project(np.array(pivots))[0]
    for i, joint in enumerate(chain.names):
        way, needle = px[i + 1] - px[i], np.subtract(*needles[joint][::-1])
        cosine = way @ needle / (np.hypot(*way) * np.hypot(*needle))
        assert cosine > 0.999


def test_the_ends_of_an_arc_are_where_the_limits_would_put_the_needle():
    chain, q = model_of("planar3").chain, stage("planar3").home.copy()
    at_home = arc(painted("planar3", "plane"), "joint2")["points"]
    for end, limit in ((0, chain.lower_rad[1]), (-1, chain.upper_rad[1])):
        q[1] = limit
        needles = of_style(painted("planar3", "plane", measured=q), "needle")
        needle = next(i for i in needles if i["joint"] == "joint2")
        np.testing.assert_allclose(needle["points"][1], at_home[end], atol=0.11)


def test_an_arc_seen_from_its_edge_is_turned_to_the_person():
    points = np.array(arc(painted(view="side"), "shoulder_pan")["points"])
    assert np.ptp(points, axis=0).min() > 20


def test_an_arc_says_where_the_joint_is_and_who_limits_it():
    own = SceneRenderer(model_of("so101"), None, {"elbow_flex": "hand sweep of 2026-11-02"})
    shown = own.draw(SceneState(looked_at("so101", "side"), at_joints(elbow_flex=0.5)))
    assert arc(shown, "elbow_flex")["label"] == (
        "elbow_flex 28.6°, -96.8° to 96.8° (hand sweep of 2026-11-02)"
    )


def test_the_calibrated_range_is_drawn_and_not_the_arm_files():
    model = model_of("so101")
    narrow = model.chain.with_limits(0.5 * model.chain.lower_rad, 0.5 * model.chain.upper_rad)
    view_state = SceneState(looked_at("so101", "side"), at_joints(elbow_flex=0.0))
    wide, own = (
        arc(SceneRenderer(model, chain).draw(view_state), "elbow_flex") for chain in (None, narrow)
    )
    assert len(own["points"]) < 0.6 * len(wide["points"])


def test_a_slide_shows_its_track_and_where_on_it_the_slide_is():
    bare = replace(model_of("so101").urdf, links=())
    model = replace(model_of("so101"), chain=crane(), urdf=bare, poses={})
    camera = looked_at("so101", "orbit")
    items = SceneRenderer(model).draw(SceneState(camera, np.array([0.0, 0.1])))
    low, high, now = camera.project(np.array([[x, 0.0, 0.5] for x in (0.0, 0.4, 0.1)]))[0]
    hub = next(i for i in of_style(items, "hub") if i["joint"] == "slide")
    np.testing.assert_allclose(arc(items, "slide")["points"], [low, high], atol=0.06)
    np.testing.assert_allclose(hub["at"], now, atol=0.06)


# --- targets ---

TIP = np.array([0.2, 0.0, 0.15])


def test_a_target_that_is_reached_is_a_green_cross():
    items = painted(marker=TargetMarker(TIP, TIP, reached=True))
    assert len(of_style(items, "target")) == 1
    assert not of_style(items, "target_far", "gap", "nearest")


def test_a_target_out_of_reach_is_red_with_the_nearest_point_and_the_way_that_is_missing():
    camera, far = looked_at("so101", "side"), TIP + np.array([0.5, 0.0, 0.0])
    items = painted(marker=TargetMarker(far, TIP, reached=False))
    (cross,), (nearest,), (gap,) = (of_style(items, s) for s in ("target_far", "nearest", "gap"))
    np.testing.assert_allclose(cross["at"], camera.project(far)[0], atol=0.06)
    np.testing.assert_allclose(nearest["at"], camera.project(TIP)[0], atol=0.06)
    assert gap["points"] == [cross["at"], nearest["at"]]


# --- surroundings ---


def test_from_the_side_the_table_is_an_edge_at_its_height():
    (floor,) = of_style(painted("open_manipulator_x", "side"), "floor")
    height = model_of("open_manipulator_x").floor_m
    y = looked_at("open_manipulator_x", "side").project(np.array([0.0, 0.0, height]))[0][1]
    assert floor["rings"][0][0][1] == pytest.approx(y, abs=0.06)


def test_lines_on_the_table_are_ten_centimetres_apart():
    grid = of_style(painted(view="top"), "grid")
    xs = sorted(
        {line["points"][0][0] for line in grid if line["points"][0][0] == line["points"][1][0]}
    )
    steps = np.diff(xs) / looked_at("so101", "top").scale_px
    np.testing.assert_allclose(steps, 0.1, atol=2e-4)


def test_the_bar_is_as_long_as_it_says():
    items = painted(view="side")
    (bar,), (words,) = of_style(items, "scale")[:1], of_style(items, "scale")[1:]
    length_m = (bar["points"][1][0] - bar["points"][0][0]) / looked_at("so101", "side").scale_px
    assert words["text"] == f"{length_m * 100:.0f} cm"


@pytest.mark.parametrize("view", VIEWS)
def test_a_box_to_keep_out_of_is_drawn_at_its_corners(view):
    box = KeepOutBox("the cup", (0.2, 0.1, 0.0), (0.3, 0.2, 0.12))
    with_box = SceneRenderer(replace(model_of("so101"), keep_out=(box,)))
    camera = looked_at("so101", view)
    (drawn,) = of_style(with_box.draw(SceneState(camera, stage("so101").home)), "keep_out")
    corners = np.unique(np.round(np.array(drawn["rings"]).reshape(-1, 2), 1), axis=0)
    expected = camera.project(np.array([[x, y, z] for x in (0.2, 0.3) for y in (0.1, 0.2)
                                        for z in (0.0, 0.12)]))[0]  # fmt: skip
    for px in expected:
        assert np.hypot(*(corners - px).T).min() < 0.15


def test_the_table_behind_the_eye_is_not_drawn():
    camera = looked_at("so101", "orbit")
    low = Camera(VIEWPORT, np.array([0.3, 0.0, 0.05]), camera.R_world_view, camera.scale_px, True)
    items = scene_renderer("so101").draw(SceneState(low, stage("so101").home))
    for item in of_style(items, "grid"):
        assert np.isfinite(np.array(item["points"], dtype=float)).all()


# --- the whole ---


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("name", ["so101", "vx300s"])
def test_a_picture_is_ready_for_json(name, view):
    goal = stage(name).home + 0.2
    items = painted(name, view, goal=goal, marker=TargetMarker(TIP, TIP, reached=False))
    assert json.loads(json.dumps(items, allow_nan=False)) == items


def test_every_item_is_of_a_kind_that_the_page_knows():
    items = painted(goal=stage("so101").home + 0.2, marker=TargetMarker(TIP, TIP, reached=False))
    needed = {"polygon": "rings", "polyline": "points", "circle": "r", "cross": "r", "text": "text"}
    for item in items:
        assert needed[item["kind"]] in item


def test_a_picture_of_ten_joints_is_projected_as_often_as_one_of_three(monkeypatch):
    """What costs as much for each joint would make pictures of long arms late."""
    calls = {}
    project = Camera.project
    for links in (3, 10):
        model = planar_model([0.1] * links)
        q, drawing = np.full(links, 0.1), SceneRenderer(model)
        camera = make_camera(drawing.extent, Viewpoint("plane"), VIEWPORT, 0.0)
        view_state = SceneState(
            camera, q, goal=q + 0.2, marker=TargetMarker(TIP, TIP, reached=False)
        )
        seen = []
        monkeypatch.setattr(Camera, "project", lambda *of, s=seen: s.append(1) or project(*of))
        drawing.draw(view_state)
        calls[links] = len(seen)
    assert calls[10] == calls[3]
