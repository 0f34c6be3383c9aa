"""`ikservo arms new`: a published description becomes a folder that moves in the simulator."""

import base64
import json
import math
import re
import shlex

import numpy as np
import pytest
import trimesh

import ikservo
from ikservo.apps.page.drawing.scene_shapes import link_shapes
from ikservo.kinematics.capsules import segment_distance
from ikservo.model.collision_capsules import capsules_of
from ikservo.model.urdf_types import Mesh
from tests.oracle import CONFIGS

LINK = """<link name="{name}"><inertial><origin xyz="0 0 0.06"/><mass value="0.1"/>
<inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/></inertial>{shapes}</link>"""
BAR = """<{tag}><origin xyz="0 0 0.06"/><geometry><mesh scale="0.001 0.001 0.001"
filename="package://desk_arm/meshes/bar.stl"/></geometry></{tag}>"""
JOINT = """<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="{xyz}"/><axis xyz="{axis}"/>{limit}</joint>"""
JAW = '<limit lower="0" upper="0.02" effort="1" velocity="1"/>'
LIMIT = '<limit lower="-1.5" upper="1.5" effort="1" velocity="1"/>'


def joint(name, kind, parent, child, *, xyz="0 0 0.14", axis="0 1 0", limit=""):
    return JOINT.format(**locals())


def both(mesh=BAR):
    return mesh.format(tag="visual") + mesh.format(tag="collision")


def published():
    """Return a base with wheels and an arm of four joints, one of them continuous, and jaws."""
    parts = [LINK.format(name=name, shapes=both()) for name in ("turret", "upper arm", "forearm")]
    return "\n".join([
        '<robot name="desk_arm"><link name="world"/>',
        LINK.format(name="chassis", shapes=both().replace("0 0 0.06", "0 0 -0.02")),
        LINK.format(name="wheel", shapes=""), LINK.format(name="palm", shapes=""),
        LINK.format(name="finger", shapes=""), LINK.format(name="thumb", shapes=""),
        '<link name="tcp"/>', *parts,
        joint("to_world", "fixed", "world", "chassis", xyz="0 0 0"),
        joint("wheel", "continuous", "chassis", "wheel", xyz="0.1 0 0", limit=""),
        joint("pan", "continuous", "chassis", "turret", xyz="0 0 0.06", axis="0 0 1"),
        joint("lift", "revolute", "turret", "upper arm", limit=LIMIT),
        joint("elbow.flex", "revolute", "upper arm", "forearm", limit=LIMIT),
        joint("palm mount", "fixed", "forearm", "palm"),
        joint("jaw", "prismatic", "palm", "finger", limit=JAW),
        joint("follower", "prismatic", "palm", "thumb",
              limit=f'{JAW}<mimic joint="jaw" multiplier="-1"/>'),
        joint("tip mount", "fixed", "palm", "tcp", xyz="0 0 0.05"),
        "</robot>",
    ])  # fmt: skip


@pytest.fixture
def source(tmp_path):
    """Return the URDF of a package that was cloned, with its meshes in millimetres."""
    package = tmp_path / "src" / "desk_arm"
    (package / "urdf").mkdir(parents=True)
    (package / "meshes").mkdir()
    trimesh.creation.box((40.0, 30.0, 120.0)).export(package / "meshes" / "bar.stl")
    (package / "urdf" / "desk.urdf").write_text(published())
    return package / "urdf" / "desk.urdf"


@pytest.fixture
def make(run_cli, source, tmp_path):
    def run(options="", name="mine", of=source):
        return run_cli(shlex.split(f"arms new {name} --from {of} --folder {tmp_path} {options}"))

    return run


@pytest.mark.full
def test_published_arm_description_moves_after_one_import(make, run_cli, tmp_path):
    assert make().code == 0
    arm = f"--arm {tmp_path}/mine"
    result = run_cli(f"move 0.25 0.1 0.25 {arm} --port sim --yes --json")
    assert (result.code, result.json["reached"]) == (0, True)
    assert run_cli(f"pose rest {arm} --port sim --yes").code == 0


def test_imported_kinematics_match_description(make, source, tmp_path):
    make()
    pin = pytest.importorskip("pinocchio")
    mine = ikservo.load_model(tmp_path / "mine")
    data = (oracle := pin.buildModelFromUrdf(str(source))).createData()
    names = {"pan": "pan", "lift": "lift", "elbow_flex": "elbow.flex"}
    for q in np.random.default_rng(4).uniform(-1.4, 1.4, (50, 3)):
        v = pin.neutral(oracle)
        for name, at in zip(mine.chain.names, q, strict=True):
            one = oracle.joints[oracle.getJointId(names[name])]
            v[one.idx_q : one.idx_q + one.nq] = [math.cos(at), math.sin(at)][: one.nq] \
                if one.nq == 2 else [at]  # fmt: skip
        pin.framesForwardKinematics(oracle, data, v)
        T = data.oMf[oracle.getFrameId("tcp")].homogeneous
        np.testing.assert_allclose(mine.chain.forward(q), T, atol=1e-12)


def test_import_report_lists_every_decision(make, tmp_path):
    make()
    report = (tmp_path / "mine" / "import.md").read_text()
    for part in ("The tip is the link tcp", "jaws are moved by jaw", "pan has no limits",
                 "Fixed, because the tip does not need them: wheel", "Joint elbow.flex was renamed",
                 "jaw slides; it is assumed",
                 "rest is where the simulated arm lay", "mm |"):  # fmt: skip
        assert part in report


def test_imported_arm_has_capsules_and_visual_meshes(make, source, tmp_path):
    make()
    model = ikservo.load_model(tmp_path / "mine")
    shapes = [shape for link in model.urdf.links for shape in link.collisions]
    assert shapes
    assert not any(isinstance(shape, Mesh) for shape in shapes)
    (picture,) = (tmp_path / "mine" / "meshes").iterdir()
    bar = trimesh.load(picture)
    np.testing.assert_allclose(bar.extents, (0.04, 0.03, 0.12), atol=1e-6)
    corners = bar.vertices + np.array([0.0, 0.0, 0.06])
    for link in ("turret", "upper arm"):
        own = [each for each in capsules_of(model) if each.link == link]
        assert own
        for corner in corners:
            away = [segment_distance(each.start_m, each.end_m, corner, corner) - each.radius_m
                    for each in own]  # fmt: skip
            assert min(away) <= 1e-5


def test_imported_arm_base_is_placed_on_table(make, tmp_path):
    make()
    model = ikservo.load_model(tmp_path / "mine")
    assert model.floor_m == pytest.approx(-0.08, abs=0.002)  # half the bar below its middle


def test_base_option_excludes_links_not_attached_to_base(make, tmp_path):
    assert make("--base turret").code == 0
    model = ikservo.load_model(tmp_path / "mine")
    assert model.urdf.root == "turret"
    assert model.chain.names == ("lift", "elbow_flex")
    assert "wheel" in (tmp_path / "mine" / "import.md").read_text()


HAND = '<link name="hand"/>' + joint(
    "roll", "revolute", "palm", "hand", xyz="0 0 0.05", axis="0 0 1", limit=LIMIT
)
TOOL = '<link name="tool"/>' + joint("tool mount", "fixed", "hand", "tool")


@pytest.mark.parametrize(
    ("hand", "tip"),
    [(HAND + TOOL, "tool"), (HAND.replace("1.5", "2.5"), "hand")],
    ids=["a tool behind it", "more than half a turn"],
)
def test_joint_that_turns_hand_is_not_imported_as_jaw(make, source, tmp_path, hand, tip):
    without_jaws = published().replace("prismatic", "fixed")
    source.write_text(without_jaws.replace("</robot>", f"{hand}</robot>"))
    assert make().code == 0
    model = ikservo.load_model(tmp_path / "mine")
    assert (model.chain.tip, model.gripper, model.chain.names[-1]) == (tip, None, "roll")


def test_jaw_exported_with_full_turn_is_imported_as_jaw(make, source, tmp_path):
    whole = published().replace("prismatic", "revolute").replace(JAW, LIMIT.replace("1.5", "3.14"))
    source.write_text(whole)
    assert make().code == 0
    assert ikservo.load_model(tmp_path / "mine").gripper.joint == "jaw"


def test_import_options_override_automatic_choices(make, tmp_path):
    options = ("--tip palm --gripper none --limits pan=-90:45 --servo lift=-7:STS3250 "
               "--servo-model STS3250 --base-frame 'rotate 90, raise 0.1'")  # fmt: skip
    assert make(options).code == 0
    model = ikservo.load_model(tmp_path / "mine")
    assert (model.chain.tip, model.gripper) == ("palm", None)
    pan = model.joint("pan").limits
    assert (pan.lower.value, pan.upper.value) == pytest.approx((-math.pi / 2, math.pi / 4))
    lift = model.joint("lift")
    assert (lift.servo.id, lift.servo.model, lift.joint_map.sign) == (7, "STS3250", -1)
    T = model.chain.forward(np.zeros(3))
    assert T[2, 3] == pytest.approx(0.1 + 0.06 + 3 * 0.14)
    np.testing.assert_allclose(T[:3, 0], (0.0, 1.0, 0.0), atol=1e-12)


def test_import_with_two_tips_makes_two_arms_with_distinct_ids(run_cli, tmp_path):
    links = ["<link name='base'/>"]
    for side, y in (("left", 0.2), ("right", -0.2)):
        parent = "base"
        for i in range(3):
            name = f"{side}_{i}"
            links.append(f"<link name='{name}'/>")
            xyz = f"0 {y} 0.1" if i == 0 else "0 0 0.1"
            links.append(joint(f"{side}_j{i}", "revolute", parent, name, xyz=xyz, limit=LIMIT))
            parent = name
    (tmp_path / "dual.urdf").write_text(f"<robot name='dual'>{''.join(links)}</robot>")
    command = f"arms new dual --from {tmp_path}/dual.urdf --folder {tmp_path}"
    refused = run_cli(command)
    assert refused.code == 2
    assert "--tip left_2 --tip right_2" in refused.err
    assert run_cli(f"{command} --tip left_2 --tip right_2").code == 0
    ids = [[joint.servo.id for joint in ikservo.load_model(tmp_path / name).joints]
           for name in ("dual_left_2", "dual_right_2")]  # fmt: skip
    assert ids == [[1, 2, 3], [4, 5, 6]]


def test_import_dry_run_writes_nothing(make, tmp_path):
    result = make("--dry-run")
    assert result.code == 0
    assert "[poses.home]" in result.out
    assert "<robot" in result.out
    assert not (tmp_path / "mine").exists()


def test_import_keeps_existing_arm_without_overwrite(make, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "arm.toml").write_text("mine")
    refused = make()
    assert refused.code == 2
    assert "--overwrite" in refused.err
    assert (tmp_path / "mine" / "arm.toml").read_text() == "mine"
    assert make("--overwrite").code == 0
    assert ikservo.load_model(tmp_path / "mine").name == "mine"


def test_import_searches_folder_for_description(make, source, tmp_path):
    folder = source.parents[2]
    assert make("--dry-run", of=folder).code == 0
    (source.parent / "other.urdf").write_text(published())
    refused = make(of=folder)
    assert "2 descriptions" in refused.err
    assert "--file" in refused.err
    assert make("--file other.urdf --dry-run", of=folder).code == 0


def test_import_finds_files_relative_to_current_folder(make, source, monkeypatch):
    folder = source.parents[2]
    (folder / "bar.stl").write_bytes((folder / "desk_arm/meshes/bar.stl").read_bytes())
    source.write_text(published().replace("package://desk_arm/meshes/bar.stl", "../../bar.stl"))
    refused = make("--dry-run")
    assert "is left out: it is outside" in refused.out
    monkeypatch.chdir(folder)
    found = make("--file desk_arm/urdf/desk.urdf --dry-run", of=".")
    assert found.code == 0
    assert "is left out" not in found.out


def test_sliding_joint_with_huge_limits_gets_usable_limits(make, source, tmp_path):
    old = joint("lift", "revolute", "turret", "upper arm", limit=LIMIT)
    endless = '<limit lower="-50" upper="-3" effort="1" velocity="1"/>'
    source.write_text(published().replace(old, joint(
        "lift", "prismatic", "turret", "upper arm", axis="0 0 1", limit=endless)))  # fmt: skip
    assert make().code == 0
    assert "lift slides" in (tmp_path / "mine" / "import.md").read_text()
    limits = ikservo.load_model(tmp_path / "mine").urdf.joints
    lift = next(each for each in limits if each.name == "lift")
    assert (lift.lower, lift.upper) == (-4.0, -3.0)


def test_import_report_names_links_without_mass(make, source, tmp_path):
    forearm = LINK.format(name="forearm", shapes=both())
    bare = f'<link name="forearm">{both()}</link>'
    source.write_text(source.read_text().replace(forearm, bare))
    assert make().code == 0
    decisions = (tmp_path / "mine" / "import.md").read_text()
    assert "No mass is given for forearm: servos and the rest pose" in decisions


def test_missing_mesh_is_omitted_from_import_and_reported(make, source, tmp_path):
    (source.parents[1] / "meshes" / "bar.stl").unlink()
    assert make().code == 0
    report = (tmp_path / "mine" / "import.md").read_text()
    assert "bar.stl is left out: the file does not exist" in report
    assert "link turret has no usable shape: a rod along it is used instead" in report
    assert capsules_of(ikservo.load_model(tmp_path / "mine"))


def test_mesh_of_120_m_size_is_omitted_from_import(make, source, tmp_path):
    source.write_text(source.read_text().replace('scale="0.001 0.001 0.001"', ""))
    assert make().code == 0
    assert (
        "bar.stl is left out, because it is 120 m large"
        in (tmp_path / "mine" / "import.md").read_text()
    )


def test_import_json_lists_every_file(make, tmp_path):
    result = make("--json --dry-run")
    (arm,) = json.loads(result.out)["arms"]
    assert set(arm["files"]) == {"arm.toml", "arm.urdf", "import.md", "meshes/01_bar.stl"}
    assert json.loads(result.out)["written"] == []


@pytest.mark.full
def test_arm_created_from_measured_lengths_moves(run_cli, tmp_path):
    joints = "--joint pan=z:0.06 --joint lift=y:0.12 --joint elbow=y:0.1"
    assert run_cli(f"arms new ruled {joints} --folder {tmp_path}").code == 0
    model = ikservo.load_model(tmp_path / "ruled")
    tip_m = model.chain.forward([0.0, math.pi / 2, 0.0])[:3, 3]
    np.testing.assert_allclose(tip_m, (0.22, 0.0, 0.11), atol=1e-9)
    result = run_cli(f"move 0.16 0.05 0.15 --arm {tmp_path}/ruled --port sim --yes --json")
    assert (result.code, result.json["reached"]) == (0, True)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ("--tip tpc", "tcp"),
        ("--base turet", "turret"),
        ("--gripper jaws", "jaw"),
        ("--limits elbow=1", "--limits"),
        ("--limits lift=3:1", "is 3 to 1 °"),
        ("--servo lift=300", "elbow=3:STS3215"),
        ("--servo lift=3:STS9", "STS3215"),
        ("--servo lif=3", "lift"),
        ("--m-per-turn lift=0.1", "slide"),
        ("--m-per-turn jaw=-1", "slide=0.04"),
        ("--base-frame 'sideways 3'", "rotate 90"),
        ("--joint a=z:0.1", "--from"),
        ("--tip world", "--tip"),
    ],
)
def test_wrong_import_option_is_refused_with_suggestion(make, tmp_path, options, said):
    result = make(options)
    assert result.code == 2
    assert said in result.err
    assert not (tmp_path / "mine").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("new a --joint pan=z:0.1 --package b=c", "--package cannot be given with --joint"),
        ("new a --joint pan=z:0.1 --joint pan=y:0.1", "pan twice"),
        ("new a --joint p=z:0.1 --joint q=y:0.1 --servo p=1 --servo q=1", "gives the id 1 twice"),
        ("new a --joint pan=z:0.1 --limits pan=-inf:inf", "-inf:inf"),
    ],
)
def test_contradicting_import_options_are_refused(run_cli, tmp_path, words, said):
    answer = run_cli(f"arms {words} --folder {tmp_path}")
    assert answer.code == 2
    assert said in answer.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["so101", "a/b", "", "x" * 65])
def test_invalid_arm_name_is_refused(run_cli, source, tmp_path, name):
    result = run_cli(f"arms new '{name}' --from {source} --folder {tmp_path}")
    assert result.code == 2


def test_shipped_arms_can_be_imported_again(run_cli, tmp_path):
    for name in ("koch", "px100"):
        path = CONFIGS / name / "arm.urdf"
        assert run_cli(f"arms new my_{name} --from {path} --folder {tmp_path}").code == 0
        ours, mine = (ikservo.load_model(each) for each in (name, tmp_path / f"my_{name}"))
        q = ours.chain.mid_range()
        np.testing.assert_allclose(
            mine.chain.forward(q, frame=ours.chain.tip), ours.chain.forward(q), atol=1e-12
        )


@pytest.mark.full
def test_limp_imported_arm_comes_to_rest_on_table(make, tmp_path):
    make()
    with ikservo.open_arm(tmp_path / "mine", port="sim:?pose=home", uncalibrated=True) as arm:
        for _ in range(40):
            arm.clock.sleep_until(arm.clock.now_s() + 1.0)
        still = arm.where()
        arm.clock.sleep_until(arm.clock.now_s() + 5.0)
        np.testing.assert_allclose(arm.where().tip_m, still.tip_m, atol=0.001)
        lowest = min(
            float(arm.model.chain.forward(list(still.positions.values())[:3], frame=link)[2, 3])
            for link in ("turret", "upper arm", "forearm", "tcp")
        )
        assert lowest > arm.model.floor_m


def test_an_imported_arm_is_drawn_with_its_meshes(make, tmp_path):
    make()
    model = ikservo.load_model(tmp_path / "mine")
    (drawn,) = link_shapes(model, "turret")
    assert drawn["shape"] == "mesh"
    corners = np.frombuffer(base64.b64decode(drawn["corners"]), "<f4").reshape(-1, 3)
    np.testing.assert_allclose(np.ptp(corners, axis=0), (0.04, 0.03, 0.12), atol=1e-6)


FOREIGN = {
    "meshes as contact shapes": ('urdf = "arm.urdf"', '<mesh filename="a.stl"/>'),
    "an MJCF": ('urdf = "arm.xml"', "<mujoco/>"),
    "a xacro": ('urdf = "arm.xacro"', ""),
}


@pytest.mark.parametrize("what", FOREIGN)
def test_arm_file_with_foreign_description_suggests_import(what, run_cli, tmp_path):
    line, content = FOREIGN[what]
    own = CONFIGS.parent / "examples" / "own_arm"
    toml = (own / "arm.toml").read_text()
    (tmp_path / "arm.toml").write_text(re.sub(r'urdf\s*= "arm.urdf"', line, toml))
    text = re.sub("<box[^>]*>", content, (own / "arm.urdf").read_text())
    (tmp_path / line.split('"')[1]).write_text(content if "xml" in line else text)
    for command in ("solve 0.1 0 0.1", "where --port sim"):
        result = run_cli(f"{command} --arm {tmp_path}")
        assert result.code == 2
        assert f"ikservo arms new NAME --from {tmp_path}" in result.err


@pytest.mark.parametrize("pose", ["home", "rest"])
def test_poses_of_imported_arm_have_clearance(make, tmp_path, pose):
    make()
    with ikservo.open_arm(tmp_path / "mine", port="sim:?pose=home", uncalibrated=True) as arm:
        assert arm.clearance_m(arm.model.pose(pose)) >= 0.0


def test_import_prints_arm_option_that_opens_new_arm(run_cli, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    made = run_cli("arms new ruled --joint pan=z:0.1 --joint lift=y:0.1")
    path = re.search(r"--arm (\S+)", made.err).group(1)
    assert run_cli(f"solve 0.05 0 0.2 --arm {path}").code in (0, 7)
    named = run_cli("solve 0.05 0 0.2 --arm ruled")
    assert named.code == 2
    assert "./ruled" in named.err
