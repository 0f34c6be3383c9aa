"""MJCF is read as MuJoCo understands it: frames, limits, masses, shapes, followers."""

import os
import sys

import mujoco
import numpy as np
import pytest
import trimesh

import ikservo
import ikservo.cli
from ikservo.apps.importing.description_sources import read_foreign
from ikservo.apps.importing.mjcf import read_mjcf
from ikservo.apps.importing.shapes import convert_shapes
from ikservo.errors import FileFormatError, InputError
from ikservo.model import Model
from ikservo.model.arm_model import link_masses
from ikservo.model.collision_capsules import collision_body
from ikservo.model.model_loading import build_chain

MJCF = """<mujoco model="made">
  <compiler angle="degree" meshdir="meshes" autolimits="true"/>
  <asset><mesh name="bar" file="bar.stl"/></asset>
  <worldbody>
    <geom name="table" type="plane" size="1 1 0.1"/>
    <body name="base" pos="0 0 0.02"><geom type="box" size="0.04 0.04 0.02"/>
      <body name="upper" pos="0.01 0 0.05" euler="10 20 30">
        <joint name="pan" axis="0 0 1" pos="0 0.005 0" range="-90 90"/>
        <joint name="lift" axis="0 1 0" pos="0.01 0 0.02" range="-80 100" ref="15"/>
        <geom type="mesh" mesh="bar" pos="0.06 0 0.02" mass="0.1"/>
        <body name="fore" pos="0.12 0 0.02">
          <joint name="elbow" axis="0 1 0"/>
          <geom type="capsule" fromto="0 0 0 0.1 0 0" size="0.012" mass="0.08"/>
          <site name="tool" pos="0.11 0 0" euler="0 90 0"/>
          <body name="left"><joint name="grip" type="slide" axis="0 1 0" range="0 0.03"/>
            <geom type="box" size="0.01 0.002 0.01" pos="0.11 0 0" mass="0.01"/></body>
          <body name="right"><joint name="follow" type="slide" axis="0 -1 0" range="0 0.03"/>
            <geom type="sphere" size="0.004" pos="0.11 0 0" mass="0.01"/></body>
        </body>
      </body>
    </body>
  </worldbody>
  <equality><joint joint1="follow" joint2="grip" polycoef="0 1 0 0 0"/></equality>
</mujoco>"""


def load(path):
    """Return the model of an MJCF file with simple shapes."""
    steps = convert_shapes(read_mjcf(path))
    while True:
        try:
            next(steps)
        except StopIteration as end:
            urdf = end.value.urdf
            break
    return Model.from_geometry("made", "made", build_chain(urdf, "tool"), urdf, path)


@pytest.fixture
def path(tmp_path):
    (tmp_path / "meshes").mkdir()
    trimesh.creation.box((0.12, 0.03, 0.02)).export(tmp_path / "meshes" / "bar.stl")
    path = tmp_path / "made.xml"
    path.write_text(MJCF)
    return path


def test_mjcf_tool_pose_matches_mujoco(path):
    model, oracle = load(path), mujoco.MjModel.from_xml_path(str(path))
    assert model.chain.names == ("pan", "lift", "elbow")
    data, random = mujoco.MjData(oracle), np.random.default_rng(1)
    for q in random.uniform(-1.0, 1.0, (20, 3)):
        for name, value in zip(model.chain.names, q, strict=True):
            data.joint(name).qpos[0] = value
        mujoco.mj_kinematics(oracle, data)
        T = model.chain.forward(q)
        np.testing.assert_allclose(T[:3, 3], data.site("tool").xpos, atol=1e-9)
        np.testing.assert_allclose(T[:3, :3].ravel(), data.site("tool").xmat, atol=1e-9)


def test_mjcf_limits_match_file(path):
    chain = load(path).chain
    np.testing.assert_allclose(np.rad2deg(chain.lower_rad[:2]), [-90, -80])
    assert chain.upper_rad[2] == np.inf


def test_mjcf_masses_and_inertias_match_mujoco(path):
    model, oracle = load(path), mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(oracle)
    data.qpos[:] = 0.0
    mujoco.mj_kinematics(oracle, data)
    mujoco.mj_comPos(oracle, data)
    poses = model.chain.link_poses(np.zeros(3))
    for mass in link_masses(model, model.chain):
        centre_m = (poses[mass.link] @ np.append(mass.centre_m, 1.0))[:3]
        np.testing.assert_allclose(centre_m, data.body(mass.link).xipos, atol=1e-9)
        assert mass.mass_kg == pytest.approx(float(oracle.body(mass.link).mass[0]))
        R, R_principal = poses[mass.link][:3, :3], data.body(mass.link).ximat.reshape(3, 3)
        tensor = R_principal @ np.diag(oracle.body(mass.link).inertia) @ R_principal.T
        np.testing.assert_allclose(R @ mass.inertia_kg_m2 @ R.T, tensor, atol=1e-9)


def test_mjcf_equality_joint_becomes_mimic(path):
    joints = {j.name: j for j in load(path).urdf.joints}
    assert (joints["follow"].mimic.joint, joints["follow"].mimic.multiplier) == ("grip", 1.0)


def test_mjcf_mimic_joint_without_limits_gets_leader_limits(path, tmp_path):
    text = MJCF.replace('axis="0 -1 0" range="0 0.03"', 'axis="0 -1 0"')
    path.write_text(text.replace('"0 1 0 0 0"', '"0.01 -2 0 0 0"'))
    folder = tmp_path / "new"
    assert ikservo.cli.main(["arms", "new", "made", "--from", str(path), "--tip", "tool",
                             "--gripper", "grip", "--folder", str(folder)]) == 0  # fmt: skip
    joints = {joint.name: joint for joint in ikservo.load_model(folder / "made").urdf.joints}
    assert (joints["follow"].lower, joints["follow"].upper) == pytest.approx((-0.05, 0.01))


def test_mjcf_bodies_all_have_capsules(path):
    gaps = collision_body(load(path)).floor_distances([[0.0, 0.0, 0.0]], -1.0)
    assert {link for link, _ in gaps.pairs} == {"base", "upper", "fore", "left", "right"}


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('file="bar.stl"', 'file="../../bar.stl"'),
        ('file="bar.stl"', 'file="/etc/passwd"'),
        ('meshdir="meshes"', 'meshdir="../../meshes"'),
        ("<asset>", '<include file="../other.xml"/><asset>'),
    ],
)
def test_mjcf_file_outside_folder_is_refused_before_mujoco(path, old, new, monkeypatch):
    monkeypatch.setattr("ikservo.apps.importing.mjcf.importlib.import_module", None)
    path.write_text(MJCF.replace(old, new))
    with pytest.raises(FileFormatError, match="outside the model's folder"):
        load(path)


@pytest.mark.skipif(sys.platform == "win32", reason="links need a privilege there")
@pytest.mark.parametrize(
    ("new", "found"),
    [
        ('<compiler strippath="true"/><asset><mesh name="bar" file="deep/link.stl"/>', "link.stl"),
        ('<asset><mesh name="bar" file="li\nnk.stl"/>', "line break"),
        ('<asset><model name="other" file="other.xml"/>', "<model> cannot be used"),
    ],
)
def test_mjcf_mesh_paths_out_of_folder_are_not_followed(path, new, found, tmp_path):
    secret = tmp_path / "secret.stl"
    secret.write_bytes((path.parent / "meshes" / "bar.stl").read_bytes())
    folder = tmp_path / "arm"
    (folder / "meshes" / "deep").mkdir(parents=True)
    for name in ("link.stl", "li\nnk.stl"):
        (folder / "meshes" / name).symlink_to(secret)
    (folder / "arm.xml").write_text(MJCF.replace("<asset>", new).replace(BAR, ""))
    with pytest.raises(FileFormatError, match=found):
        read_mjcf(folder / "arm.xml")


BAR = '<mesh name="bar" file="bar.stl"/>'
ASSET = f"<asset>{BAR}</asset>"


def test_mjcf_included_mesh_uses_mesh_folder_of_first_file(path):
    (path.parent / "assets.xml").write_text(f"<mujoco>{ASSET}</mujoco>")
    text = MJCF.replace(ASSET, '<include file="assets.xml"/>')
    path.write_text(text)
    assert {link.name for link in read_mjcf(path).links} >= {"base", "upper", "fore"}
    path.write_text(text.replace('meshdir="meshes"', 'meshdir=".."'))
    with pytest.raises(FileFormatError, match="outside the model's folder"):
        read_mjcf(path)


@pytest.mark.parametrize(
    ("old", "new", "found"),
    [
        ('<joint name="elbow" axis="0 1 0"/>', '<joint name="elbow" type="ball"/>', "ball"),
        ("<worldbody>", "<worldbody><nonsense/>", "MuJoCo refuses it"),
    ],
)
def test_mjcf_ball_joint_and_unknown_element_are_refused(path, old, new, found):
    assert old in MJCF
    path.write_text(MJCF.replace(old, new))
    with pytest.raises(FileFormatError, match=found):
        load(path)


def test_mjcf_loose_bodies_are_omitted_and_free_base_is_fixed(path):
    def parts():
        urdf = read_mjcf(path)
        return urdf.joints, [(link.name, link.mass_kg, link.com_m) for link in urdf.links]

    alone = parts()
    cube = """<body name="cube" pos="0.3 0 0.1"><freejoint/><geom type="box" size=".01 .01 .01"/>
      <site name="top"/><body name="sticker"><geom size="0.01"/></body></body>
      <body name="target" mocap="true"><geom type="sphere" size="0.01"/></body>"""
    text = MJCF.replace("<worldbody>", f"<worldbody>{cube}")
    path.write_text(text)
    assert parts() == alone
    assert [each.split()[0] for each in read_mjcf(path).warnings] == ["cube", "target"]
    path.write_text(text.replace('pos="0 0 0.02">', 'pos="0 0 0.02"><freejoint/>'))
    assert parts() == alone


def test_mjcf_without_mujoco_says_what_to_install(path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "mujoco", None)
    with pytest.raises(InputError, match="needs mujoco") as caught:
        load(path)
    assert "[physics]" in caught.value.hint


def test_mjcf_in_package_may_use_meshes_of_neighbouring_folder(path):
    (path.parent / "package.xml").write_text("<package><name>made</name></package>")
    folder = path.parent / "model"
    folder.mkdir()
    inner = folder / "arm.xml"
    inner.write_text(MJCF.replace('"meshes"', '"../meshes"'))
    assert read_foreign(inner, {}, {}, allow_xacro=False, folder=folder).urdf.links


def frames(urdf):
    return [(each.name, each.xyz_m, each.rpy_rad, each.lower, each.upper) for each in urdf.joints]


MULTIPLIED = {
    "textures": '<texture name="t{i}" type="2d" builtin="checker" width="2048" height="2048"/>',
    "a texture of a picture": '<texture name="t{i}" type="2d" file="huge.png"/>',
    "height fields": '<hfield name="h{i}" nrow="2048" ncol="2048" size="1 1 1 1"/>',
}


@pytest.mark.parametrize("element", MULTIPLIED.values(), ids=MULTIPLIED)
def test_mjcf_assets_that_multiply_memory_are_not_compiled(path, element, monkeypatch):
    before, seen = read_mjcf(path), []
    many = "".join(element.format(i=i) for i in range(500))
    of_texture = '<material name="m" texture="t0" rgba="1 0 0 1"/>' if "texture" in element else ""
    path.write_text(MJCF.replace("<asset>", f"<asset>{many}{of_texture}"))
    compile_ = mujoco.MjModel.from_xml_string
    monkeypatch.setattr(
        mujoco.MjModel, "from_xml_string", lambda text: seen.append(text) or compile_(text)
    )
    assert frames(read_mjcf(path)) == frames(before)
    assert len(seen[0]) < len(MJCF) + 500


def test_mjcf_size_and_keyframe_elements_are_ignored(path):
    before = read_mjcf(path)
    more = '<size nkey="60000000" nuser_body="900"/><keyframe><key qpos="1"/></keyframe>'
    path.write_text(MJCF.replace("<worldbody>", f"{more}<worldbody>"))
    assert frames(read_mjcf(path)) == frames(before)


def test_mjcf_mesh_that_is_a_pipe_is_refused(path):
    mesh = path.parent / "meshes" / "bar.stl"
    mesh.unlink()
    os.mkfifo(mesh)
    with pytest.raises(FileFormatError, match="not a regular file"):
        read_mjcf(path)


def test_mjcf_that_repeats_a_large_mesh_is_refused(path, monkeypatch):
    monkeypatch.setattr("ikservo.apps.importing.mjcf._MAX_MESHES_BYTES", 3_000)
    read_mjcf(path)
    again = "".join(f'<mesh name="bar{i}" file="bar.stl"/>' for i in range(9))
    path.write_text(MJCF.replace("<asset>", f"<asset>{again}"))
    with pytest.raises(FileFormatError, match=r"(?s)too large.*MiB in all"):
        read_mjcf(path)


def test_mjcf_that_includes_a_file_twice_is_refused(path):
    (path.parent / "more.xml").write_text("<mujoco/>")
    path.write_text(MJCF.replace("<asset>", 2 * '<include file="more.xml"/>' + "<asset>"))
    with pytest.raises(FileFormatError, match="again"):
        read_mjcf(path)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('range="-90 90"', 'range="90 -90"'),
        ('range="-90 90"', 'range="90 -90" limited="true"'),
        ('range="-90 90"', 'range="nan 90"'),
        ('range="-90 90"', 'range="45 45"'),
        ('range="-90 90"', 'range="-90 90" actuatorfrcrange="5 -5"'),
        ("<worldbody>", '<default><joint range="1 -1"/></default><worldbody>'),
    ],
)
def test_mjcf_with_reversed_limits_is_refused(path, old, new):
    path.write_text(MJCF.replace(old, new))
    with pytest.raises(FileFormatError, match=r"line \d+.*range"):
        read_mjcf(path)


def test_mjcf_import_writes_no_log_and_prints_nothing(path, tmp_path, monkeypatch, capfd):
    work = tmp_path / "work"
    work.mkdir()
    monkeypatch.chdir(work)
    box = '<geom type="box" size="0.04 0.04 0.02"/>'
    path.write_text(MJCF.replace(box, f"<nonsense/>{box}"))
    with pytest.raises(FileFormatError, match=f"{path.name}.*nonsense.*line 6"):
        read_mjcf(path)
    path.write_text(MJCF)
    compile_ = mujoco.MjModel.from_xml_string

    def warning(text):
        model = compile_(text)
        mujoco.mj_setConst(model, data := mujoco.MjData(model))
        data.qpos[:] = 1e30
        mujoco.mj_step(model, data)  # warns
        return model

    monkeypatch.setattr(mujoco.MjModel, "from_xml_string", warning)
    read_mjcf(path)
    assert list(work.iterdir()) == []
    assert capfd.readouterr() == ("", "")
