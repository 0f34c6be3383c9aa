"""An arm as it is published: every shape a mesh, named by package, in millimetres."""

import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest
import trimesh

import ikservo
from ikservo.model.collision_model import collision_body
from tests.oracle import CONFIGS
from tests.view.view_session import ViewSession


def as_mesh(geometry):
    """Return a simple shape of a URDF as a mesh [mm]."""
    shape = geometry[0]
    if shape.tag == "box":
        mesh = trimesh.creation.box([float(x) for x in shape.attrib["size"].split()])
    else:
        mesh = trimesh.creation.cylinder(float(shape.get("radius")), float(shape.get("length")))
    mesh.apply_scale(1000.0)
    return mesh


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return the folder of a SO-101 whose shapes are STL files in another folder of the model."""
    home = tmp_path_factory.mktemp("published")
    (home / "urdf").mkdir()
    (home / "meshes").mkdir()
    tree = ET.parse(CONFIGS / "so101" / "arm.urdf")
    for link in tree.getroot().iter("link"):
        for i, collision in enumerate(link.findall("collision")):
            geometry, name = collision.find("geometry"), f"{link.get('name')}_{i}.stl"
            as_mesh(geometry).export(home / "meshes" / name)
            geometry.clear()
            mesh = {
                "filename": f"package://so101_description/meshes/{name}",
                "scale": "1e-3 1e-3 1e-3",
            }
            ET.SubElement(geometry, "mesh", mesh)
        for visual in link.findall("visual"):
            link.remove(visual)
    tree.write(home / "urdf" / "arm.urdf")
    text = (CONFIGS / "so101" / "arm.toml").read_text()
    (home / "arm.toml").write_text(text.replace('"arm.urdf"', '"urdf/arm.urdf"'))
    return home


@pytest.fixture
def words(folder):
    return f"--arm {folder} --port sim:{folder}/arm.toml?pose=home"


@pytest.mark.full
def test_it_moves(run_cli, words):
    result = run_cli(f"move 0.2 0.05 0.12 {words} --yes --json")
    assert (result.code, result.json["reached"]) == (0, True)


def test_it_says_where_it_is(run_cli, words):
    result = run_cli(f"where {words} --json")
    assert result.code == 0
    assert len(result.json["joints"]) == 6


def test_it_does_not_go_through_the_table(run_cli, words):
    result = run_cli(f"joints shoulder_lift=30 {words} --yes")
    assert result.code == 8
    assert re.search(r"\w+ would touch the table", result.err)


def test_it_is_drawn(folder, monkeypatch):
    opened = ikservo.open_arm(folder, f"sim:{folder}/arm.toml?pose=home")
    monkeypatch.setattr("tests.view.view_session.open_arm", lambda *_: opened)
    with ViewSession() as session:
        assert session.latest_frames()["scene"]


def test_its_body_is_about_as_large_as_that_of_simple_shapes(folder):
    simple, meshed = (ikservo.load_model(arm) for arm in ("so101", folder))
    postures = np.array([simple.chain_pose(name) for name in simple.poses])
    above = [collision_body(model).floor_distances(postures, 0.0) for model in (simple, meshed)]
    assert above[0].pairs == above[1].pairs
    np.testing.assert_allclose(above[1].gap_m, above[0].gap_m, atol=0.008)


def test_a_missing_mesh_is_named_with_its_link_before_anything_moves(run_cli, folder, words):
    mesh = folder / "meshes" / "upper_arm_1.stl"
    mesh.rename(mesh.with_suffix(".gone"))
    try:
        result = run_cli(f"move 0.2 0.05 0.12 {words} --yes")
    finally:
        mesh.with_suffix(".gone").rename(mesh)
    assert result.code == 2
    assert "upper_arm_1.stl, mesh of link upper_arm: the file does not exist" in result.err
