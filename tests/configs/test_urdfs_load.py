"""The shipped URDFs load unchanged in Pinocchio and MuJoCo, with plausible masses."""

from __future__ import annotations

import importlib.util
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import mujoco
import numpy as np
import pinocchio
import pytest

ROOT = Path(__file__).parents[2]
CONFIGS = ROOT / "configs"
ARMS = sorted(path.parent.name for path in CONFIGS.glob("*/arm.urdf"))

# From base to tool at zero, copied a second time from the sources: xyz [m], rpy [rad].
# fmt: off
CHAINS = {
    "so101": [
        ((0.0388353, -8.97657e-09, 0.0624),        (3.14159, 4.18253e-17, -3.14159)),
        ((-0.0303992, -0.0182778, -0.0542),        (-1.5708, -1.5708, 0)),
        ((-0.11257, -0.028, 0),                    (0, 0, 1.5708)),
        ((-0.1349, 0.0052, 0),                     (0, 0, -1.5708)),
        ((0, -0.0611, 0.0181),                     (1.5708, 0.0486795, 3.14159)),
        ((-0.0079, -0.000218121, -0.0981274),      (0, 3.14159, 0)),
    ],
    "so100": [
        ((0, -0.0452, 0.0165),                     (1.57079, 0, 0)),
        ((0, 0.1025, 0.0306),                      (-1.8, 0, 0)),
        ((0, 0.11257, 0.028),                      (1.57079, 0, 0)),
        ((0, 0.0052, 0.1349),                      (-1, 0, 0)),
        ((0, -0.0601, 0),                          (0, 1.57079, 0)),
        ((0.0079, -0.0981, 0),                     (np.pi / 2, 0, 0)),
    ],
    "koch": [
        ((0.0401555, 0.0326246, 0.0166573),        (0, 0, 0)),
        ((-0.0188, 0, 0.0154),                     (3.14159, -1.5708, 0)),
        ((0.1083, -0.0148, 0.00425),               (0, 0, 1.5708)),
        ((-0.100476, -0.00269986, 0.02925),        (-3.14159, 0, 1.5708)),
        ((0, -0.0450002, 0.0133967),               (-1.5708, -1.5708, 0)),
        ((-0.008, 0, -0.065),                      (0, np.pi, 0)),
    ],
}

# The source's base frame in ours, where ours is another: xyz [m], rpy [rad].
BASES = {
    "so100": ((-0.0452, 0, 0),                     (0, 0, np.pi / 2)),
    "koch":  ((-0.0326246, 0.0401555, 0.022),      (0, 0, -np.pi / 2)),
}

# The makers' frames do not turn at zero: the tip is the sum of the origins [m].
TIPS_M = {
    "open_manipulator_x": (0.012 + 0.024 + 0.124 + 0.126,            0,        0.0595 + 0.128),
    "omx_f":              (0.0415 + 0.162 + 0.0287 + 0.09193 - 0.01125, -0.0016, 0.0975 + 0.11315),
    "omx_l":              (0.2235 - 0.0095,                          0,        0.0965 + 0.1075),
    "px100":              (0.248575,                                 0,        0.1931),
    "px150":              (0.358575,                                 0,        0.25457),
    "rx150":              (0.358575,                                 0,        0.25457),
    "rx200":              (0.408575,                                 0,        0.30457),
    "wx200":              (0.408575,                                 0,        0.31065),
    "vx250":              (0.468575,                                 0,        0.37705),
    "wx250s":             (0.458325,                                 0,        0.36065),
    "vx300s":             (0.536494,                                 0,        0.42705),
    "planar2":            (0.15 + 0.15,                              0,        0.05),
    "planar3":            (0.12 + 0.12 + 0.08,                       0,        0.05),
}

# What the whole arm may weigh [kg]: parts lists and makers' sheets.
MASS_KG = {
    "so101": (0.6, 0.7), "so100": (0.6, 0.8), "koch": (0.3, 0.45),
    "open_manipulator_x": (0.65, 0.75), "omx_f": (0.5, 0.65), "omx_l": (0.3, 0.4),
    "px100": (0.7, 0.9), "px150": (1.7, 2.0), "rx150": (1.6, 1.9), "rx200": (1.7, 2.0),
    "wx200": (1.7, 2.0), "vx250": (2.7, 3.2), "wx250s": (2.0, 2.4), "vx300s": (3.3, 4.0),
    "planar2": (0.2, 0.5), "planar3": (0.2, 0.6),
}
# fmt: on


def urdf(arm: str) -> ET.Element:
    return ET.parse(CONFIGS / arm / "arm.urdf").getroot()


def tip_of(arm: str) -> str:
    return [link.attrib["name"] for link in urdf(arm).iter("link")][-1]


def mujoco_of(arm: str) -> tuple[mujoco.MjModel, mujoco.MjData]:
    spec = mujoco.MjSpec.from_file(str(CONFIGS / arm / "arm.urdf"))
    spec.compiler.fusestatic = False  # MuJoCo would melt base and tool frame into their neighbours
    model = spec.compile()
    return model, mujoco.MjData(model)


def pinocchio_frames(arm: str, q: np.ndarray) -> dict[str, np.ndarray]:
    model = pinocchio.buildModelFromUrdf(str(CONFIGS / arm / "arm.urdf"))
    data = model.createData()
    pinocchio.framesForwardKinematics(model, data, q)
    frames = zip(model.frames, data.oMf, strict=True)
    return {f.name: T.homogeneous for f, T in frames if f.type == pinocchio.FrameType.BODY}


def mujoco_frames(arm: str, q: np.ndarray) -> dict[str, np.ndarray]:
    model, data = mujoco_of(arm)
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    frames = {}
    for index in range(1, model.nbody):
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = data.xmat[index].reshape(3, 3), data.xpos[index]
        frames[model.body(index).name] = T
    return frames


def transform(xyz: tuple[float, ...], rpy: tuple[float, ...]) -> np.ndarray:
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    T = np.eye(4)
    T[:3, :3] = (
        np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
        @ np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
        @ np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    )
    T[:3, 3] = xyz
    return T


def expected_tip_m(arm: str) -> np.ndarray:
    if arm in TIPS_M:
        return np.array(TIPS_M[arm])
    T_world_tool = transform(*BASES.get(arm, ((0, 0, 0), (0, 0, 0))))
    for xyz, rpy in CHAINS[arm]:
        T_world_tool = T_world_tool @ transform(xyz, rpy)
    return T_world_tool[:3, 3]


def moving(arm: str) -> int:
    return sum(joint.attrib["type"] != "fixed" for joint in urdf(arm).iter("joint"))


def inertials(arm: str) -> list[tuple[str, float, np.ndarray]]:
    found = []
    for link in urdf(arm).iter("link"):
        if (inertial := link.find("inertial")) is not None:
            entries = inertial.find("inertia").attrib
            i = {key: float(value) for key, value in entries.items()}
            rows = [("ixx", "ixy", "ixz"), ("ixy", "iyy", "iyz"), ("ixz", "iyz", "izz")]
            tensor = np.array([[i[key] for key in row] for row in rows])
            mass_kg = float(inertial.find("mass").attrib["value"])
            found.append((link.attrib["name"], mass_kg, tensor))
    return found


def inertia_tool():
    spec = importlib.util.spec_from_file_location("inertias", ROOT / "tools" / "inertias.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["inertias"] = module  # where its dataclass looks for its own module
    spec.loader.exec_module(module)
    return module


def test_sixteen_arm_models_are_shipped():
    assert set(ARMS) == set(CHAINS) | set(TIPS_M)


@pytest.mark.parametrize("arm", ARMS)
def test_pinocchio_finds_every_moving_joint(arm):
    model = pinocchio.buildModelFromUrdf(str(CONFIGS / arm / "arm.urdf"))
    assert model.nq == moving(arm)


@pytest.mark.parametrize("arm", ARMS)
def test_mujoco_finds_every_moving_joint(arm):
    assert mujoco.MjModel.from_xml_path(str(CONFIGS / arm / "arm.urdf")).nq == moving(arm)


@pytest.mark.parametrize("arm", ARMS)
def test_mujoco_loads_urdf_without_messages(arm, capfd):
    mujoco.MjModel.from_xml_path(str(CONFIGS / arm / "arm.urdf"))
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("arm", ARMS)
def test_pinocchio_tip_at_zero_matches_the_source_of_the_urdf(arm):
    tip_m = pinocchio_frames(arm, np.zeros(moving(arm)))[tip_of(arm)][:3, 3]
    assert tip_m == pytest.approx(expected_tip_m(arm), abs=1e-9)


@pytest.mark.parametrize("arm", ARMS)
def test_mujoco_tip_at_zero_matches_the_source_of_the_urdf(arm):
    tip_m = mujoco_frames(arm, np.zeros(moving(arm)))[tip_of(arm)][:3, 3]
    assert tip_m == pytest.approx(expected_tip_m(arm), abs=1e-9)


def test_so101_tip_at_zero_matches_published_position():
    assert expected_tip_m("so101") == pytest.approx((0.39136, 0.0, 0.22647), abs=1e-5)


@pytest.mark.parametrize("arm", ARMS)
def test_pinocchio_and_mujoco_agree_on_every_link_of_a_bent_arm(arm):
    q = np.random.default_rng(7).uniform(-0.5, 0.5, moving(arm))
    ours, theirs = pinocchio_frames(arm, q), mujoco_frames(arm, q)
    for name, T_world_link in theirs.items():
        assert T_world_link == pytest.approx(ours[name], abs=1e-9), name


@pytest.mark.parametrize("arm", ARMS)
def test_urdf_link_without_mass_is_only_the_tool_frame(arm):
    massless = {link.attrib["name"] for link in urdf(arm).iter("link") if not len(link)}
    assert massless == {tip_of(arm)}


@pytest.mark.parametrize("arm", ARMS)
def test_urdf_inertias_are_physically_possible(arm):
    for name, mass_kg, tensor in inertials(arm):
        smallest, middle, largest = np.linalg.eigvalsh(tensor)
        assert mass_kg > 0.0, name
        assert smallest > 0.0, name
        assert largest < smallest + middle, name


@pytest.mark.parametrize("arm", ARMS)
def test_urdf_mass_of_the_arm_is_plausible(arm):
    lightest_kg, heaviest_kg = MASS_KG[arm]
    assert lightest_kg < sum(mass_kg for _, mass_kg, _ in inertials(arm)) < heaviest_kg


@pytest.mark.parametrize("arm", ARMS)
def test_urdf_inertias_equal_output_of_inertia_tool(arm):
    text = (CONFIGS / arm / "arm.urdf").read_text()
    assert inertia_tool().rewritten(text) == text


def test_inertia_tool_sums_mass_of_servo_and_beam():
    link = ET.fromstring("""
        <link name="arm">
          <inertial><mass value="0.155"/></inertial>
          <collision name="elbow STS3215">
            <origin xyz="0 0 0" rpy="0 0 0"/><geometry><box size="0.06 0.03 0.03"/></geometry>
          </collision>
          <collision name="beam">
            <origin xyz="0 0 0.31" rpy="0 0 0"/><geometry><box size="0.06 0.03 0.03"/></geometry>
          </collision>
        </link>""")
    mass_kg, centre_m, inertia = inertia_tool().mass_properties(link)
    about_y = 0.155 * (0.06**2 + 0.03**2) / 12 + 0.055 * 0.2**2 + 0.1 * 0.11**2
    assert mass_kg == 0.155
    assert centre_m == pytest.approx((0.0, 0.0, 0.2))
    assert inertia[1, 1] == pytest.approx(about_y)


@pytest.mark.parametrize("arm", ARMS)
def test_urdf_visual_shapes_equal_collision_shapes(arm):
    for link in urdf(arm).iter("link"):
        assert shapes(link, "visual") == shapes(link, "collision")


def shapes(link: ET.Element, tag: str) -> list[tuple]:
    found = [(e.attrib, e.find("origin").attrib, e.find("geometry")[0]) for e in link.iter(tag)]
    return [(name, origin, shape.tag, shape.attrib) for name, origin, shape in found]


@pytest.mark.parametrize("arm", ARMS)
def test_urdf_neighbouring_links_are_less_than_3_mm_apart(arm):
    model, data = mujoco_of(arm)
    mujoco.mj_forward(model, data)
    for body in range(2, model.nbody):
        if model.body_geomnum[body]:
            parent = model.body_parentid[body]
            assert gap_m(model, data, body, parent) < 0.003, model.body(body).name


def gap_m(model: mujoco.MjModel, data: mujoco.MjData, body: int, other: int) -> float:
    ours, theirs = (np.flatnonzero(model.geom_bodyid == b) for b in (body, other))
    pairs = [(int(a), int(b)) for a in ours for b in theirs]
    return min(mujoco.mj_geomDistance(model, data, a, b, 1.0, None) for a, b in pairs)
