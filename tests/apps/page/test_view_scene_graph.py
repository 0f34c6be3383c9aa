"""A page receives the arm once, then only the positions of joints."""

import base64
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from ikservo.apps.page.drawing.scene_shapes import link_shapes
from ikservo.apps.page.drawing.view_picture import SceneState
from ikservo.apps.page.messages import page_messages
from ikservo.apps.page.panels.things_panel import thing_fields
from ikservo.apps.page.picking.link_poses import link_poses
from ikservo.model import load_model
from ikservo.model.arm_model import KeepOutBox
from ikservo.model.urdf_types import Mesh
from tests.apps.page.view_fixtures import graph_of, looked_at, model_of, stage
from tests.apps.page.view_session import ViewSession
from tests.oracle import ARMS

FRAME_S = 1 / 60


def with_visual(model, link, shape, collisions=None):
    """Return a model with one visual shape on a link, and other collision shapes if given."""
    links = tuple(
        replace(each, visuals=(shape,), colours=(),
                collisions=each.collisions if collisions is None else collisions)
        if each.name == link else each
        for each in model.urdf.links
    )  # fmt: skip
    return replace(model, urdf=replace(model.urdf, links=links))


def placed(graph, positions):
    """Return T_world_link of every link as the page computes it, by name."""
    poses, left = {}, iter(positions)
    for link in graph.description["links"]:
        T = np.array(link["origin"]).reshape(4, 4)
        parent = np.eye(4) if link["parent"] is None else poses[link["parent"]]
        if link["joint"] == "prismatic":
            T = T @ trimesh.transformations.translation_matrix(next(left) * np.array(link["axis"]))
        elif link["joint"] != "fixed":
            T = T @ trimesh.transformations.rotation_matrix(next(left), link["axis"])
        poses[link["name"]] = parent @ T
    assert not list(left)
    return poses


@pytest.mark.parametrize("name", ARMS)
def test_page_link_poses_match_forward_kinematics(name):
    model, graph = model_of(name), graph_of(model_of(name))
    rng = np.random.default_rng(3)
    q = rng.uniform(model.chain.lower_rad, model.chain.upper_rad)
    others = {model.gripper.joint: 0.5 * model.gripper.open} if model.gripper else {}
    fields = graph.fields(SceneState(looked_at(name, "top"), q, other_joints=others))
    expected = link_poses(model.chain, q, others)
    found = placed(graph, fields["measured"])
    assert set(found) == set(expected)
    for link, T in expected.items():
        assert np.abs(found[link] - T).max() < 1e-6, link


def test_every_link_is_sent_with_its_shapes():
    graph = graph_of(model_of("so101"))
    names = [link["name"] for link in graph.description["links"]]
    assert list(graph.shapes["links"]) == names
    assert graph.shapes["links"]["base"] == link_shapes(model_of("so101"), "base") != []


def test_goal_at_measured_position_does_not_show_preview():
    graph, q = graph_of(model_of("so101")), stage("so101").home
    state = SceneState(looked_at("so101", "top"), q, goal=q + 1e-4)
    assert graph.fields(state)["goal"] is None
    assert graph.fields(replace(state, goal=q + 0.1))["goal"] is not None


def test_link_shapes_have_colours_of_urdf():
    foot, post, servo = link_shapes(model_of("so101"), "base")
    assert foot["shape"] == post["shape"] == servo["shape"] == "box"
    assert foot["size"] == (0.1, 0.09, 0.026)
    assert foot["colour"] == (0.95, 0.78, 0.15)
    assert servo["colour"] == (0.12, 0.12, 0.13)


def test_every_scene_message_key_is_documented_in_protocol(session):
    page = Path(__file__).parents[3].joinpath("tools/pages/formats.py").read_text("utf-8")
    graph = graph_of(model_of("so101")).description
    scene = session.latest_frames()["scene"]
    keys = {*scene, *scene["camera"], *graph, *graph["links"][-1], *graph["dials"][0]}
    assert {key for key in keys if f"`{key}`" not in page} == {"kind"}


def test_mesh_is_sent_as_triangles(tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=1, radius=30.0)
    path = tmp_path / "ball.stl"
    ball.export(path)
    mesh = Mesh(path.name, path, (0.001, 0.001, 0.001), (0.1, 0.0, 0.0), (0.0, 0.0, 0.0))
    (shape,) = link_shapes(with_visual(model_of("so101"), "wrist", mesh), "wrist")
    corners = np.frombuffer(base64.b64decode(shape["corners"]), "<f4").reshape(-1, 3)
    assert len(corners) == 3 * len(ball.faces)
    assert np.allclose(np.linalg.norm(corners, axis=1), 0.030, atol=1e-5)
    assert shape["pose"][3] == 0.1


def test_a_missing_mesh_is_drawn_as_the_collision_shapes(tmp_path):
    model = model_of("so101")
    lost = Mesh("lost.stl", tmp_path / "lost.stl", (1.0, 1.0, 1.0), (0, 0, 0), (0, 0, 0))
    shapes = link_shapes(with_visual(model, "wrist", lost), "wrist")
    assert len(shapes) == len(model.urdf.link("wrist").collisions) > 0
    assert {shape["colour"] for shape in shapes} == {None}
    assert link_shapes(with_visual(model, "wrist", lost, collisions=(lost,)), "wrist") == []


@pytest.mark.parametrize(
    "content", [b"", b"solid x", b"\0" * 84, b"\0" * 80 + b"\xff" * 4, b"\0" * 3_000_000]
)
def test_a_damaged_mesh_is_drawn_as_the_collision_shapes(tmp_path, content):
    (tmp_path / "a.stl").write_bytes(content)
    mesh = Mesh("a.stl", tmp_path / "a.stl", (1.0, 1.0, 1.0), (0, 0, 0), (0, 0, 0))
    model = model_of("so101")
    shapes = link_shapes(with_visual(model, "wrist", mesh), "wrist")
    assert len(shapes) == len(model.urdf.link("wrist").collisions)


class Wire:
    """Counts the bytes of a session's frames on the wire, where only changes are sent."""

    def __init__(self, session):
        self.session, self.known, self.bytes, self.kinds = session, {}, 0, []

    def run(self, seconds, on_frame=lambda _: None):
        """Run frames in virtual time; return the bytes per second."""
        self.bytes = 0
        for count in range(round(seconds / FRAME_S)):
            self.session.clock.sleep_until(self.session.clock.now_s() + FRAME_S)
            on_frame(count)
            for frame in self.session.controller.frames(self.session.client):
                self.add(frame)
        return self.bytes / seconds

    def add(self, frame):
        known = self.known.setdefault(frame["kind"], {})
        changed = {k: v for k, v in frame.items() if k == "kind" or known.get(k, known) != v}
        known.update(frame)
        self.kinds.append(frame["kind"])
        self.bytes += len(json.dumps({**changed, "seq": 100_000}, default=list))


@pytest.fixture
def session():
    with ViewSession() as session:
        yield session


@pytest.mark.full
@pytest.mark.parametrize(
    ("view", "webgl"), [("side", False), ("top", False), ("orbit", False), ("orbit", True)]
)
def test_arm_geometry_is_sent_to_page_only_once(session, view, webgl):
    look = {"w": 900, "h": 700, "dpr": 1, "view": view}
    session.send_message(page_messages.SetViewport, **look, webgl=webgl)
    wire = Wire(session)
    wire.run(1.0)
    assert wire.kinds.count("graph") == 1
    assert wire.kinds.count("shapes") == webgl
    assert wire.run(2.0) <= 20_000
    session.point("down", 450, 300)

    def move(count):
        session.point("move", 450 + 150 * math.sin(count / 30), 300 + 100 * math.sin(count / 17))

    assert wire.run(2.0, move) <= 60_000
    assert session.interaction.goal is not None
    session.send_message(page_messages.SetViewport, **look, webgl=not webgl)
    wire.run(0.2)
    assert wire.kinds.count("graph") == 1
    assert wire.kinds.count("shapes") == (view == "orbit")


@pytest.mark.full
def test_reachable_region_is_sent_only_when_it_changes(session):
    session.send_message(page_messages.SetViewport, w=900, h=700, dpr=1, view="top")
    wire = Wire(session)
    wire.run(0.1)
    session.controller._composer._regions._busy[1].result(timeout=60)
    wire.run(0.1)
    first = wire.known["scene"]["region"]
    wire.run(0.5)
    assert wire.known["scene"]["region"] is first
    assert len(json.dumps(first)) > wire.bytes


def test_side_view_is_drawn_on_canvas_even_with_webgl(session):
    session.send_message(page_messages.SetViewport, w=900, h=700, dpr=1, view="side", webgl=True)
    frames = session.latest_frames()
    assert "shapes" not in frames
    assert not frames["scene"]["webgl"]


def test_page_shows_calibrated_joint_range():
    model = model_of("so101")
    narrow = model.chain.with_limits(0.5 * model.chain.lower_rad, 0.5 * model.chain.upper_rad)
    dial = next(d for d in graph_of(model, narrow).description["dials"] if d["link"] == "forearm")
    assert dial["range"] == [narrow.lower_rad[2], narrow.upper_rad[2]]


def test_scene_graph_contains_table_height():
    assert graph_of(replace(load_model("so101"), floor_m=-0.02)).description["floor"] == -0.02


def test_keep_out_box_is_in_scene_graph_for_drawing():
    fields = thing_fields(KeepOutBox("shelf", (0.2, 0.1, 0.0), (0.3, 0.2, 0.4)))
    assert (fields["name"], fields["shape"], fields["drawn"]) == ("shelf", "box", True)
    np.testing.assert_allclose(fields["half"], (0.05, 0.05, 0.2))
    np.testing.assert_allclose(np.reshape(fields["pose"], (4, 4))[:3, 3], (0.25, 0.15, 0.2))
