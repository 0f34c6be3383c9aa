"""The simulator is given what the kinematics read, with a simple shape wherever a link has one."""

import numpy as np
import pytest
import trimesh

import ikservo
from ikservo.model.loading import build_chain, load_model
from ikservo.model.simulated_description import description_for_simulator, plain_urdf
from ikservo.model.urdf import read_urdf
from ikservo.model.urdf_types import Cylinder
from tests.model.test_mjcf import MJCF
from tests.oracle import CONFIGS

EXAMPLE = CONFIGS.parent / "examples" / "own_arm"
COLLISION = '<collision><origin xyz="0 0 0.07"/><geometry>{}</geometry></collision>'
FOREARM = COLLISION.format('<box size="0.025 0.03 0.1"/>')


@pytest.fixture
def own_arm(tmp_path, monkeypatch):
    """Return a function that writes the example with another collision shape of its forearm."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    bar = trimesh.creation.box((25.0, 30.0, 100.0))
    bar.export(tmp_path / "bar.stl")
    trimesh.creation.box((80.0, 80.0, 40.0)).export(tmp_path / "foot.stl")

    def write(forearm):
        text = (EXAMPLE / "arm.urdf").read_text()
        assert FOREARM in text
        (tmp_path / "arm.urdf").write_text(text.replace(FOREARM, forearm))
        (tmp_path / "arm.toml").write_text((EXAMPLE / "arm.toml").read_text())
        return tmp_path / "arm.toml"

    return write


MESH = COLLISION.format('<mesh filename="bar.stl" scale="1e-3 1e-3 1e-3"/>')
SHAPES = {"a mesh": MESH, "only a visual shape": ""}


@pytest.mark.parametrize("name", ["so101", "vx300s", "omx_f"])
def test_a_plain_urdf_is_the_arm_again(name, tmp_path):
    model = load_model(name)
    (tmp_path / "arm.urdf").write_text(plain_urdf(model.urdf))
    again = read_urdf(tmp_path / "arm.urdf")
    joints = [(j.name, j.kind, j.parent, j.child, j.lower, j.upper, j.mimic) for j in again.joints]
    assert joints == [
        (j.name, j.kind, j.parent, j.child, j.lower, j.upper, j.mimic) for j in model.urdf.joints
    ]
    chain, q = build_chain(again, model.chain.tip), np.full(model.chain.dof, 0.3)
    np.testing.assert_allclose(chain.forward(q), model.chain.forward(q), atol=1e-12)
    assert [(k.mass_kg, k.inertia_kg_m2) for k in again.links] == [
        (k.mass_kg, k.inertia_kg_m2) for k in model.urdf.links
    ]


def test_an_arm_of_simple_shapes_is_simulated_from_its_own_file():
    assert description_for_simulator(load_model("so101")) is None


@pytest.mark.full
@pytest.mark.parametrize("shape", SHAPES)
def test_a_limp_arm_does_not_fall_through_the_table_with_a_forearm_of(shape, own_arm):
    path = own_arm(SHAPES[shape])
    heights_m = []
    for arm in (EXAMPLE / "arm.toml", path):
        with ikservo.open_arm(arm, port="sim:?pose=zero") as opened:
            opened.enable()
            opened.move_joints({"shoulder": 0.5})
            opened.disable_torque()
            opened.clock.sleep_until(opened.clock.now_s() + 20.0)
            heights_m.append(opened.where().tip_m[2])
    assert heights_m[1] == pytest.approx(heights_m[0], abs=0.01)
    assert heights_m[0] > 0.0


def test_a_capsule_of_a_mesh_is_a_cylinder_where_the_mesh_is(own_arm, tmp_path):
    urdf = load_model(own_arm(MESH)).urdf
    (tmp_path / "plain.urdf").write_text(plain_urdf(urdf))
    (found,) = read_urdf(tmp_path / "plain.urdf").link("forearm").collisions
    assert isinstance(found, Cylinder)
    np.testing.assert_allclose(found.xyz_m, (0.0, 0.0, 0.07), atol=0.002)
    assert 0.08 < found.length_m < 0.13


def test_an_arm_whose_mesh_is_missing_is_not_simulated_without_contact(own_arm, tmp_path):
    path = own_arm(MESH)
    (tmp_path / "bar.stl").unlink()
    with pytest.raises(ikservo.IkservoError, match=r"bar\.stl, mesh of link forearm"):
        ikservo.open_arm(path, port="sim")
    with ikservo.open_arm(path, port="sim", collisions=False) as opened:
        assert opened.where().joints


def test_an_mjcf_is_simulated(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    pytest.importorskip("mujoco")
    (tmp_path / "meshes").mkdir()
    trimesh.creation.box((0.12, 0.03, 0.02)).export(tmp_path / "meshes" / "bar.stl")
    (tmp_path / "arm.xml").write_text(MJCF)
    joints = [f'[[joints]]\nname = "{name}"\nrole = "arm"\nzero_from = "vendor"\n'
              f'servo = {{ id = {i}, model = "STS3215", sign = 1, zero_tick = 2048 }}'
              for i, name in enumerate(("pan", "lift", "elbow"), start=1)]  # fmt: skip
    own = (EXAMPLE / "arm.toml").read_text()
    head = own.split("[[joints]]")[0].replace("arm.urdf", "arm.xml").replace('"tip"', '"tool"')
    poses = [f"[poses.{pose}]\ndeg = {{ pan = 0.0, lift = 0.0, elbow = 0.0 }}"
             for pose in ("rest", "home", "zero")]  # fmt: skip
    (tmp_path / "arm.toml").write_text("\n".join([head, *joints, *poses]))
    with ikservo.open_arm(tmp_path / "arm.toml", port="sim") as opened:
        tip_m = opened.where().tip_m
    model = load_model(tmp_path / "arm.toml")
    np.testing.assert_allclose(tip_m, model.chain.forward(np.zeros(3))[:3, 3], atol=0.01)
