"""The picture on the canvas, computed by the page from the arm that it received once.

Drawn shapes agree with the camera, forward kinematics and the joints' positions.
"""

import json
import math
from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest
from pydantic_core import to_json
from scipy.spatial import ConvexHull

from ikservo.apps.page.dragging.goal_planning import PlannedPath
from ikservo.apps.page.dragging.solver_demo import trace_method
from ikservo.apps.page.dragging.target_marker import TargetMarker
from ikservo.apps.page.drawing.reachable_region import ReachableRegion, slice_plane
from ikservo.apps.page.drawing.view_picture import SceneState
from ikservo.apps.page.panels.things_panel import thing_fields
from ikservo.apps.page.picking.link_poses import link_poses
from ikservo.apps.page.picking.projection import Camera
from ikservo.apps.page.picking.viewpoints import available_views
from ikservo.kinematics.capsules import segment_distance
from ikservo.model.arm_model import KeepOutBox
from ikservo.model.collision_capsules import capsules_of
from tests.apps.page.planar_arm import planar_model
from tests.apps.page.view_fixtures import VIEWPORT, graph_of, looked_at, model_of, picker, stage
from tests.browser.page_operator import with_long_timeout
from tests.kinematics.chains import crane, planar
from tests.oracle import ARMS, tip_from_joints

pytestmark = pytest.mark.browser

VIEWS = ["side", "top", "front", "orbit"]
PAGE = files("ikservo.apps.page") / "static"
HOST = "http://page.test/"
COMPOSE = """async ([graph, scene, things]) => {
  const { Picture } = await import("/page/picture.js");
  const picture = new Picture();
  picture.setGraph(graph);
  picture.setThings(things);
  return picture.compose(scene);
}"""
COMPOSE_ALL = """async ([graph, scenes]) => {
  const { Picture } = await import("/page/picture.js");
  const picture = new Picture();
  picture.setGraph(graph);
  const found = [];
  let kept = {};
  for (const changes of scenes) {
    kept = { ...kept, ...changes };
    const before = picture.last;
    const { items, backdrop } = picture.compose(kept);
    found.push({ items, backdrop, as_before: [items === before?.items, backdrop === before?.backdrop] });
  }
  return found;
}"""  # noqa: E501
PLACE = """async ([graph, positions]) => {
  const { placeLinks } = await import("/page/kinematics.js");
  return positions.map((each) => Object.fromEntries([...placeLinks(graph, each)].map(([name, { pose }]) => [name, pose])));
}"""  # noqa: E501


def serve(route):
    name = route.request.url.removeprefix(HOST).removeprefix("page/")
    body = (PAGE / name).read_text("utf-8") if name else "<!doctype html>"
    route.fulfill(body=body, content_type="text/javascript" if name else "text/html")


@pytest.fixture(scope="module")
def page(browser):
    """A page with the modules of the package and nothing else."""
    context = browser.new_context()
    page = with_long_timeout(context.new_page())
    page.route(f"{HOST}**", serve)
    page.goto(HOST)
    yield page
    context.close()


class Canvas:
    """Composes pictures of arms with the page's own modules."""

    def __init__(self, page):
        self._page = page

    def evaluate(self, script, *values):
        return self._page.evaluate(script, json.loads(to_json(values)))

    def compose(self, graph, state, things=(), **more):
        """Return items, backdrop and the goal's pixel of a scene among things."""
        scene = scene_of(graph, state, **more)
        return self.evaluate(COMPOSE, graph.description, scene, [thing_fields(t) for t in things])

    def items(self, name="so101", view="side", **shown):
        """Return all items of an arm at home, back to front."""
        state = {"measured": stage(name).home, **shown}
        return painted(
            self.compose(graph_of(model_of(name)), SceneState(looked_at(name, view), **state))
        )


def compose_in_turn(canvas, graph, state, *changes):
    """Return the pictures of a scene and of its successors, which are sent as changes."""
    first = scene_of(graph, state, seq=1)
    return canvas.evaluate(COMPOSE_ALL, graph.description, [first, *changes])


def scene_of(graph, state, **more):
    """Return a scene as the server sends it."""
    return {
        "kind": "scene", "webgl": False, "refusal": None, "trace": None, "trace_step": 0,
        **graph.fields(state), **more,
    }  # fmt: skip


def painted(picture):
    return [*picture["backdrop"], *picture["items"]]


@pytest.fixture
def canvas(page):
    return Canvas(page)


def of_style(items, *styles):
    return [item for item in items if item["style"] in styles]


def of_link(items, style, link):
    return [item for item in of_style(items, style) if item.get("link") == link]


def at_joints(**positions):
    """Return the joints of the pose home with some at other positions."""
    chain, q = model_of("so101").chain, stage("so101").home.copy()
    for name, position in positions.items():
        q[chain.names.index(name)] = position
    return q


def arc(items, joint):
    return next(i for i in items if i.get("joint") == joint and i["style"] in
                ("limit", "amber", "red"))  # fmt: skip


def random_postures(model, count):
    """Return joints (count, dof) inside the limits, and positions of the gripper."""
    random, chain = np.random.default_rng(7), model.chain
    q = random.uniform(np.maximum(chain.lower_rad, -3), np.minimum(chain.upper_rad, 3),
                       (count, chain.dof))  # fmt: skip
    if model.gripper is None:
        return q, [{}] * count
    ends = sorted([model.gripper.closed, model.gripper.open])
    return q, [{model.gripper.joint: at} for at in random.uniform(*ends, count)]


def bare_model(chain):
    """Return a model of joints without bodies."""
    model = model_of("so101")
    urdf = replace(model.urdf, links=())
    return replace(model, chain=chain, urdf=urdf, poses={}, gripper=None)


def views_of(name):
    return available_views(stage(name))


# --- the arm ---


@pytest.mark.parametrize("name", ARMS)
def test_drawn_links_match_forward_kinematics(canvas, name):
    model, graph = model_of(name), graph_of(model_of(name))
    q, others = random_postures(model, 20)
    camera = looked_at(name, views_of(name)[0])
    states = [SceneState(camera, *each) for each in zip(q, strict=True)]
    states = [replace(each, other_joints=at) for each, at in zip(states, others, strict=True)]
    sent = [graph.fields(state)["measured"] for state in states]
    drawn = canvas.evaluate(PLACE, graph.description, sent)
    for found, joints, at in zip(drawn, q, others, strict=True):
        expected = link_poses(model.chain, joints, at)
        assert set(found) == set(expected)
        for link, T in expected.items():
            np.testing.assert_allclose(np.reshape(found[link], (4, 4)), T, atol=1e-6)
        tip_m = tip_from_joints(name, dict(zip(model.chain.names, joints, strict=True)))
        drawn_m = np.reshape(found[model.chain.tip], (4, 4))[:3, 3]
        np.testing.assert_allclose(drawn_m, tip_m, atol=1e-6)


@pytest.mark.parametrize("name", ["so101", "koch", "wx250s", "planar3"])
def test_drawn_link_outlines_match_lines_of_sight(canvas, name):
    model, graph = model_of(name), graph_of(model_of(name))
    q, others = random_postures(model, 5)
    for view in views_of(name):
        camera = looked_at(name, view)
        for joints, at in zip(q, others, strict=True):
            state = SceneState(camera, joints, other_joints=at)
            drawn = of_style(canvas.compose(graph, state)["items"], "measured")
            rings = {item["link"]: item["rings"] for item in drawn}
            poses = link_poses(model.chain, joints, at)
            assert set(rings) == {capsule.link for capsule in capsules_of(model)}
            for link, outlines in rings.items():
                own = [capsule for capsule in capsules_of(model) if capsule.link == link]
                for ring, capsule in zip(outlines, own, strict=True):
                    check_outline(np.array(ring), capsule, poses[link], camera)


def check_outline(ring, capsule, T_world_link, camera):
    """Compare a ring with the exact outline of a capsule, by lines of sight and by its surface."""
    a, b = capsule.ends(T_world_link)
    origins, directions = camera.rays(ring)
    gaps = segment_distance(origins, origins + 20.0 * directions, a, b) / capsule.radius_m
    assert gaps.max() < 1.0001
    assert gaps.min() > 0.987  # circles of 20 corners: chords over 18° are 1.2 % inside
    hull, px = ConvexHull(ring), camera.project(surface_of(capsule, T_world_link))[0]
    outside_px = (hull.equations[:, :2] @ px.T + hull.equations[:, 2:]).max()
    radius_px = capsule.radius_m * float(camera.pixels_per_metre(camera.depth_of([a, b])).max())
    assert outside_px < 0.013 * radius_px + 0.01


def surface_of(capsule, T_world_link):
    """Return points (n, 3) all over a capsule."""
    ways = np.random.default_rng(5).normal(size=(300, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    return np.vstack([end + capsule.radius_m * ways for end in capsule.ends(T_world_link)])


AROUND = 1.2 * np.array([(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)])


def inside(ring, px):
    """Return whether a pixel is inside a ring, by the winding number of the ring."""
    arms = np.array(ring) - px
    turns = np.arctan2(arms[:, 1], arms[:, 0])
    return abs(np.sum(np.angle(np.exp(1j * np.diff(np.append(turns, turns[0])))))) > 1.0


@pytest.mark.parametrize("view", VIEWS)
def test_drawn_arm_covers_pixels_at_which_it_is_picked(canvas, view):
    home, camera = stage("so101").home, looked_at("so101", view)
    drawn = {item["link"]: item["rings"] for item in of_style(canvas.items(view=view), "measured")}
    poses, random = link_poses(model_of("so101").chain, home, {}), np.random.default_rng(2)
    for px in random.uniform((280, 180), (560, 520), (150, 2)):
        for hit in picker("so101").pick_all_at(camera, poses, px, 1):
            rings = drawn[hit.link]
            assert any(inside(ring, px + d) for ring in rings for d in AROUND)


def test_link_outlines_have_same_winding_direction(canvas):
    for item in of_style(canvas.items(view="orbit"), "measured"):
        for ring in item["rings"]:
            x, y = np.array(ring).T
            assert x @ np.roll(y, -1) - y @ np.roll(x, -1) < 0


@pytest.mark.parametrize("view", VIEWS)
def test_links_are_drawn_from_back_to_front(canvas, view):
    model, camera, home = model_of("so101"), looked_at("so101", view), stage("so101").home
    poses, ends = link_poses(model.chain, home, {}), {}
    for capsule in capsules_of(model):
        ends.setdefault(capsule.link, []).extend(capsule.ends(poses[capsule.link]))
    order = [item["link"] for item in of_style(canvas.items(view=view), "measured")]
    depths_m = [camera.depth_of(ends[link]).mean() for link in order]
    assert np.diff(depths_m).max() < 2e-6


def test_links_at_equal_depth_are_drawn_in_order_of_names(canvas):
    """In its own plane such an arm has these links at one depth, except for rounding."""
    graph, drawn = (
        graph_of(model_of("wx250s")),
        ["forearm", "lower_forearm", "shoulder", "upper_arm"],
    )
    for q in random_postures(model_of("wx250s"), 8)[0]:
        state = SceneState(looked_at("wx250s", "side", q), q)
        links = [
            item["link"] for item in of_style(canvas.compose(graph, state)["items"], "measured")
        ]
        assert [link for link in links if link in drawn] == drawn


def test_preview_is_drawn_only_if_goal_differs_from_arm(canvas):
    home = stage("so101").home
    assert not of_style(canvas.items(goal=home), "ghost")
    assert len(of_style(canvas.items(goal=home + 0.1), "ghost")) == 7


def test_preview_is_drawn_behind_measured_arm(canvas):
    styles = [item["style"] for item in canvas.items(goal=stage("so101").home + 0.1)]
    assert max(i for i, s in enumerate(styles) if s == "ghost") < styles.index("measured")


def test_refused_goal_marks_links_that_would_collide(canvas):
    goal, pair = stage("so101").home + 0.1, ("gripper", "floor")
    items = canvas.items(goal=goal, refused_pair=pair)
    assert [item["link"] for item in of_style(items, "touching")] == ["gripper"]
    assert len(of_style(items, "refused")) == 6
    assert not of_style(items, "ghost")


def test_selected_hidden_link_is_outlined_over_other_links(canvas):
    assert of_style(canvas.items(hover="base"), "behind") == []
    items = canvas.items(hover="base", behind=True)
    (over,) = of_style(items, "behind")
    (under,) = [i for i in items if i.get("link") == "base"]
    assert over["rings"] == under["rings"]
    assert items.index(over) > max(n for n, item in enumerate(items) if item.get("link"))


def test_hovered_and_grabbed_links_are_highlighted(canvas):
    items = canvas.items(hover="forearm", grabbed="wrist")
    assert [i["link"] for i in of_style(items, "hover")] == ["forearm"]
    assert [i["link"] for i in of_style(items, "grabbed")] == ["wrist"]


def test_drawn_jaw_opens_with_the_gripper_joint(canvas):
    closed, opened = (
        next(
            i
            for i in of_style(canvas.items(other_joints={"gripper": q}), "measured")
            if i["link"] == "jaw"
        )
        for q in (0.0, 1.0)
    )
    assert closed["rings"] != opened["rings"]


def test_tip_mark_is_drawn_at_tip_of_forward_kinematics(canvas):
    home = stage("so101").home
    tip = model_of("so101").chain.forward(home)[:3, 3]
    (mark,) = of_style(canvas.items(), "tip")
    np.testing.assert_allclose(mark["at"], looked_at("so101", "side").project(tip)[0], atol=0.01)


# --- ranges ---


def test_joint_range_is_drawn_as_arc_with_position_needle(canvas):
    items = canvas.items(view="orbit")
    for joint in model_of("so101").chain.names:
        assert arc(items, joint)["style"] == "limit"
        assert [i for i in of_style(items, "needle") if i["joint"] == joint]


@pytest.mark.parametrize(
    ("room_deg", "style"),
    [(-0.5, "red"), (-0.2, "amber"), (0.0, "amber"), (4.9, "amber"), (5.1, "limit")],
)
@pytest.mark.parametrize("side", ["lower_rad", "upper_rad"])
def test_joint_arc_is_amber_near_its_limit_and_red_beyond_it(canvas, side, room_deg, style):
    limit = getattr(model_of("so101").chain, side)[2]
    q = at_joints(elbow_flex=limit + math.radians(room_deg) * (1 if side == "lower_rad" else -1))
    assert arc(canvas.items(measured=q), "elbow_flex")["style"] == style


def test_joint_arc_of_limp_joint_beyond_its_limit_is_amber(canvas):
    state = SceneState(looked_at("so101", "side"), at_joints(elbow_flex=2.0))
    graph = graph_of(model_of("so101"))
    styles = [
        arc(canvas.compose(graph, state, limp=limp)["items"], "elbow_flex")["style"]
        for limp in ([], ["wrist_flex"], ["elbow_flex"])
    ]
    assert styles == ["red", "red", "amber"]


def test_joint_arc_is_amber_once_its_goal_is_at_the_limit(canvas):
    goal = at_joints(elbow_flex=float(model_of("so101").chain.upper_rad[2]))
    assert arc(canvas.items(goal=goal), "elbow_flex")["style"] == "amber"


def test_joint_arc_needle_points_along_link_behind_joint(canvas):
    camera, q = looked_at("planar3", "plane"), stage("planar3").home
    chain = model_of("planar3").chain
    needles = {
        i["joint"]: i["points"] for i in of_style(canvas.items("planar3", "plane"), "needle")
    }
    pivots = [chain.forward(q, link)[:3, 3] for link in ("upper_arm", "forearm", "hand", "tool")]
    px = camera.project(np.array(pivots))[0]
    for i, joint in enumerate(chain.names):
        way, needle = px[i + 1] - px[i], np.subtract(*needles[joint][::-1])
        cosine = way @ needle / (np.hypot(*way) * np.hypot(*needle))
        assert cosine > 0.999


def test_joint_arc_ends_at_needle_angles_of_the_limits(canvas):
    chain, q = model_of("planar3").chain, stage("planar3").home.copy()
    at_home = arc(canvas.items("planar3", "plane"), "joint2")["points"]
    for end, limit in ((0, chain.lower_rad[1]), (-1, chain.upper_rad[1])):
        q[1] = limit
        needles = of_style(canvas.items("planar3", "plane", measured=q), "needle")
        needle = next(i for i in needles if i["joint"] == "joint2")
        np.testing.assert_allclose(needle["points"][1], at_home[end], atol=0.01)


def test_joint_arc_seen_edge_on_is_turned_towards_viewer(canvas):
    points = np.array(arc(canvas.items(view="side"), "shoulder_pan")["points"])
    assert np.ptp(points, axis=0).min() > 20


@pytest.mark.parametrize("view", ["top", "side"])
def test_continuous_joint_is_drawn_as_a_circle_with_its_needle(canvas, view):
    state = SceneState(looked_at("so101", view), np.array([0.4]))
    items = canvas.compose(graph_of(bare_model(planar(0.1, limit_rad=np.inf))), state)["items"]
    ring = np.array(arc(items, "j1")["points"])
    (needle,) = (item["points"] for item in of_style(items, "needle"))
    assert arc(items, "j1")["style"] == "limit"
    np.testing.assert_allclose(ring[0], ring[-1], atol=0.01)
    opposite = 2 * np.array(needle[0]) - needle[1]
    np.testing.assert_allclose(ring[0], opposite, atol=0.01)


def test_calibrated_range_is_drawn_instead_of_arm_file_range(canvas):
    model = model_of("so101")
    narrow = model.chain.with_limits(0.5 * model.chain.lower_rad, 0.5 * model.chain.upper_rad)
    state = SceneState(looked_at("so101", "side"), at_joints(elbow_flex=0.0))
    wide, own = (
        arc(canvas.compose(graph_of(model, chain), state)["items"], "elbow_flex")
        for chain in (None, narrow)
    )
    assert len(own["points"]) < 0.6 * len(wide["points"])


def test_prismatic_joint_is_drawn_as_track_with_its_position(canvas):
    camera, q = looked_at("so101", "orbit"), np.array([0.0, 0.1])
    items = canvas.compose(graph_of(bare_model(crane())), SceneState(camera, q))["items"]
    low, high, now = camera.project(np.array([[x, 0.0, 0.5] for x in (0.0, 0.4, 0.1)]))[0]
    hub = next(i for i in of_style(items, "hub") if i["joint"] == "slide")
    np.testing.assert_allclose(arc(items, "slide")["points"], [low, high], atol=0.01)
    np.testing.assert_allclose(hub["at"], now, atol=0.01)


# --- targets ---

TIP = np.array([0.2, 0.0, 0.15])


def test_reached_target_is_drawn_as_a_green_cross(canvas):
    items = canvas.items(marker=TargetMarker(TIP, TIP, reached=True))
    assert len(of_style(items, "target")) == 1
    assert not of_style(items, "target_far", "gap", "nearest")


def test_refused_target_is_drawn_as_a_red_cross(canvas):
    marker = TargetMarker(TIP, TIP, reached=True)
    items = canvas.items(marker=marker, refused_pair=())
    assert len(of_style(items, "target_refused")) == 1
    assert not of_style(items, "target")


def test_target_out_of_reach_is_drawn_with_nearest_point_and_gap(canvas):
    camera, far = looked_at("so101", "side"), TIP + np.array([0.5, 0.0, 0.0])
    items = canvas.items(marker=TargetMarker(far, TIP, reached=False))
    (cross,), (nearest,), (gap,) = (of_style(items, s) for s in ("target_far", "nearest", "gap"))
    np.testing.assert_allclose(cross["at"], camera.project(far)[0], atol=0.01)
    np.testing.assert_allclose(nearest["at"], camera.project(TIP)[0], atol=0.01)
    assert gap["points"] == [cross["at"], nearest["at"]]


def test_refusal_text_is_placed_at_target_or_goal_tip(canvas):
    graph, camera, goal = graph_of(model_of("so101")), looked_at("so101", "side"), at_joints()
    goal[2] += 0.3
    state = SceneState(camera, stage("so101").home, goal=goal)
    tip = model_of("so101").chain.forward(goal)[:3, 3]
    np.testing.assert_allclose(
        canvas.compose(graph, state)["goalAt"], camera.project(tip)[0], atol=0.01
    )
    marked = replace(state, marker=TargetMarker(TIP, TIP, reached=True))
    np.testing.assert_allclose(
        canvas.compose(graph, marked)["goalAt"], camera.project(TIP)[0], atol=0.01
    )


# --- iterations of a solver ---

LECTURE = planar_model([0.12, 0.10, 0.08])
START = np.array([0.3, 0.6, -0.4])


def steps_of(canvas, target_m, method, step):
    """Return the trace of a method, the camera, and the items at one of its steps."""
    trace, graph = trace_method(LECTURE.chain, target_m, START, method), graph_of(LECTURE)
    camera = looked_at("planar3", "plane")
    more = {"trace": trace.page_fields, "trace_step": step % trace.count}
    return trace, camera, canvas.compose(graph, SceneState(camera, START), **more)["items"]


def test_solver_iteration_is_drawn_at_its_joint_positions(canvas):
    trace, camera, items = steps_of(canvas, (0.05, 0.18, 0.0), "ccd", 5)
    (drawn,) = of_style(items, "iterate")
    q = trace.result.trace[trace.numbers[5]]
    links = ("link1", "link2", "link3", "tool")
    expected = camera.project(np.array([LECTURE.chain.forward(q, x)[:3, 3] for x in links]))[0]
    np.testing.assert_allclose(drawn["points"], expected, atol=0.06)
    assert len(of_style(items, "joint")) == 3


def test_solver_iteration_draws_tip_trace_up_to_that_iteration(canvas):
    _, _, items = steps_of(canvas, (0.05, 0.18, 0.0), "pseudo_inverse", 4)
    (way,) = of_style(items, "trace")
    assert len(way["points"]) == len(of_style(items, "iteration")) == 5
    assert items[-1]["style"] == "target"


def test_unreachable_target_turns_red_at_last_solver_iteration(canvas):
    for step, style in ((0, "target"), (-1, "target_far")):
        _, _, items = steps_of(canvas, (0.5, 0.2, 0.0), "ccd", step)
        assert items[-1]["style"] == style


# --- surroundings ---


def test_table_is_drawn_as_line_in_side_view(canvas):
    (floor,) = of_style(canvas.items("open_manipulator_x", "side"), "floor")
    height = model_of("open_manipulator_x").floor_m
    y = looked_at("open_manipulator_x", "side").project(np.array([0.0, 0.0, height]))[0][1]
    assert floor["rings"][0][0][1] == pytest.approx(y, abs=0.01)


def test_table_grid_lines_are_10_cm_apart(canvas):
    grid = of_style(canvas.items(view="top"), "grid")
    ends = [np.array(line["points"]) for line in grid]
    xs = sorted(a[0] for a, b in ends if abs(a[0] - b[0]) < 1e-6)
    steps = np.diff(xs) / looked_at("so101", "top").scale_px
    assert len(xs) == 21
    np.testing.assert_allclose(steps, 0.1, atol=1e-6)


def test_drawn_scale_bar_has_length_of_its_label(canvas):
    (bar,), (words,) = of_style(canvas.items(), "scale")[:1], of_style(canvas.items(), "scale")[1:]
    length_m = (bar["points"][1][0] - bar["points"][0][0]) / looked_at("so101", "side").scale_px
    assert words["text"] == f"{length_m * 100:.0f} cm"
    assert not of_style(canvas.items(view="orbit"), "scale")


@pytest.mark.parametrize("view", VIEWS)
def test_keep_out_box_is_drawn_at_its_corners(canvas, view):
    box = KeepOutBox("the cup", (0.2, 0.1, 0.0), (0.3, 0.2, 0.12))
    graph = graph_of(model_of("so101"))
    camera = looked_at("so101", view)
    state = SceneState(camera, stage("so101").home)
    picture = canvas.compose(graph, state, [box])
    (drawn,) = of_style(picture["backdrop"], "keep_out")
    corners = np.array(drawn["rings"]).reshape(-1, 2)
    expected = camera.project(np.array([[x, y, z] for x in (0.2, 0.3) for y in (0.1, 0.2)
                                        for z in (0.0, 0.12)]))[0]  # fmt: skip
    for px in expected:
        assert np.hypot(*(corners - px).T).min() < 0.01
    assert not of_style(picture["items"], "picked")
    marked = {"picked": {"picked": "the cup"}, "touching": {"refused_pair": ("the cup",)}}
    for style, fields in marked.items():
        (over,) = of_style(canvas.compose(graph, replace(state, **fields), [box])["items"], style)
        assert over["rings"] == drawn["rings"]


def test_table_behind_the_camera_is_not_drawn(canvas):
    camera = looked_at("so101", "orbit")
    low = Camera(VIEWPORT, np.array([0.3, 0.0, 0.05]), camera.R_world_view, camera.scale_px, True)
    graph = graph_of(model_of("so101"))
    picture = canvas.compose(graph, SceneState(low, stage("so101").home))
    ends = [end for line in of_style(picture["backdrop"], "grid") for end in line["points"]]
    ahead = camera.forward * (1.0, 1.0, 0.0)
    horizon_y = low.project(low.eye_m + 1e6 * ahead)[0][1]
    assert np.array(ends)[:, 1].min() > horizon_y  # what is behind the eye would be above it


def test_reachable_region_is_drawn_in_its_plane(canvas):
    q, ring = stage("so101").home, [[0.1, 0.0], [0.3, 0.0], [0.3, 0.2]]
    plane = slice_plane(stage("so101"), "side", q, lambda: TIP)
    items = canvas.items(region=ReachableRegion((ring,), plane.T_world_plane))
    (drawn,) = of_style(items, "reach")
    T = plane.T_world_plane
    expected = looked_at("so101", "side").project(np.array(ring) @ T[:3, :2].T + T[:3, 3])[0]
    np.testing.assert_allclose(drawn["rings"][0], expected, atol=0.01)


def test_planned_and_travelled_paths_of_the_tip_are_drawn(canvas):
    start, goal = at_joints(), at_joints(shoulder_lift=-1.2)
    around = at_joints(shoulder_lift=-1.0, elbow_flex=0.3)
    graph, camera = graph_of(model_of("so101")), looked_at("so101", "side")
    there = [*np.linspace(start, around, 13), *np.linspace(around, goal, 13)[1:]]
    path = PlannedPath(None, plan="found", postures=[(q, {}) for q in there])
    state = SceneState(camera, start, goal=goal, path=path)
    on_the_way = [
        graph.fields(replace(state, measured=start + part * (goal - start))) for part in (0.3, 0.6)
    ]
    changes = [{"seq": 2 + i, "measured": each["measured"]} for i, each in enumerate(on_the_way)]
    *_, last = compose_in_turn(canvas, graph, state, *changes)
    (planned,), (travelled,) = (of_style(last["items"], each) for each in ("planned", "travelled"))
    tip_px = lambda q: camera.project(model_of("so101").chain.forward(q)[:3, 3])[0]  # noqa: E731
    np.testing.assert_allclose(planned["points"], [tip_px(q) for q in there], atol=0.01)
    swept = of_link(last["backdrop"], "swept", "gripper")
    for ghost, q in zip(swept, there[4:24:4], strict=True):
        (arm,) = of_link(canvas.items(measured=q), "measured", "gripper")
        np.testing.assert_allclose(np.vstack(ghost["rings"]), np.vstack(arm["rings"]), atol=0.01)
    expected = [tip_px(start + part * (goal - start)) for part in (0.0, 0.3, 0.6)]
    np.testing.assert_allclose(travelled["points"], expected, atol=0.01)


# --- the whole ---


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("name", ["so101", "vx300s"])
def test_drawing_items_have_known_kind_and_finite_pixels(canvas, name, view):
    goal = stage(name).home + 0.2
    items = canvas.items(name, view, goal=goal, marker=TargetMarker(TIP, TIP, reached=False))
    needed = {"polygon": "rings", "polyline": "points", "circle": "at", "cross": "at", "text": "at"}
    for item in items:
        pixels = item[needed[item["kind"]]]
        rings = pixels if item["kind"] == "polygon" else [pixels]
        assert all(np.isfinite(np.array(ring, dtype=float)).all() for ring in rings)


def test_canvas_draws_only_markers_in_3d_mode(canvas):
    marker = TargetMarker(TIP, TIP, reached=True)
    state = SceneState(looked_at("so101", "orbit"), stage("so101").home, marker=marker)
    picture = canvas.compose(graph_of(model_of("so101")), state, webgl=True)
    assert [item["style"] for item in picture["items"]] == ["tip", "target"]
    assert picture["backdrop"] is None


def test_canvas_redraws_only_changed_items(canvas):
    graph, home = graph_of(model_of("so101")), stage("so101").home
    state = SceneState(looked_at("so101", "side"), home)
    top = scene_of(graph, replace(state, camera=looked_at("so101", "top")))
    changes = [{"seq": 2}, {"hover": "base"}, {"camera": top["camera"]}]
    first, *later = compose_in_turn(canvas, graph, state, *changes)
    assert [each["as_before"] for each in later] == [[True, True], [False, True], [False, False]]
    assert later[0]["items"] == first["items"]
    assert of_style(later[1]["items"], "hover")
    assert (
        later[2]["backdrop"]
        == canvas.compose(graph, replace(state, camera=looked_at("so101", "top")))["backdrop"]
    )


def test_table_is_drawn_again_after_return_from_3d_mode(canvas):
    graph = graph_of(model_of("so101"))
    state = SceneState(looked_at("so101", "orbit"), stage("so101").home)
    first, in_3d, again = compose_in_turn(canvas, graph, state, {"webgl": True}, {"webgl": False})
    assert in_3d["backdrop"] is None
    assert again["backdrop"] == first["backdrop"]
    assert again["items"] == first["items"]
