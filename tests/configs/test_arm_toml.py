"""The shipped ``arm.toml`` files are complete, agree with their URDF and name safe poses."""

from __future__ import annotations

import tomllib
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from itertools import pairwise
from math import tau
from pathlib import Path

import mujoco
import numpy as np
import pytest

CONFIGS = Path(__file__).parents[2] / "configs"
ARMS = sorted(path.parent.name for path in CONFIGS.glob("*/arm.toml"))
POSES = ("rest", "home", "zero")


def read(arm: str) -> dict:
    return tomllib.loads((CONFIGS / arm / "arm.toml").read_text())


def urdf(arm: str) -> ET.Element:
    return ET.parse(CONFIGS / arm / "arm.urdf").getroot()


def limits(arm: str) -> dict[str, tuple[float, float]]:
    """Return lower and upper limit [rad or m] of every joint with a servo, in file order."""
    return {
        joint.attrib["name"]: tuple(float(joint.find("limit").get(k)) for k in ("lower", "upper"))
        for joint in urdf(arm).iter("joint")
        if joint.attrib["type"] != "fixed" and joint.find("mimic") is None
    }


def turns(arm: str) -> set[str]:
    return {j.attrib["name"] for j in urdf(arm).iter("joint") if j.attrib["type"] == "revolute"}


def servos(arm: str) -> Iterator[dict]:
    for joint in read(arm)["joints"]:
        yield joint["servo"]
        yield from joint.get("shadows", [])


def ticks(servo: dict, position: float) -> int:
    per_turn = servo.get("m_per_turn", tau)
    return round(servo["zero_tick"] + servo["sign"] * position / per_turn * 4096)


def positions(arm: str, pose: str) -> dict[str, float]:
    """Return a pose as a mapping of joint to rad or m."""
    tables = read(arm)["poses"][pose]
    turned = {name: float(np.deg2rad(deg)) for name, deg in tables["deg"].items()}
    return turned | tables.get("m", {})


def posed(arm: str, pose: str) -> tuple[mujoco.MjModel, mujoco.MjData]:
    spec = mujoco.MjSpec.from_file(str(CONFIGS / arm / "arm.urdf"))
    spec.compiler.fusestatic = False
    model = spec.compile()
    data = mujoco.MjData(model)
    for name, position in with_mimics(arm, positions(arm, pose)).items():
        data.joint(name).qpos[0] = position
    mujoco.mj_forward(model, data)
    return model, data


def with_mimics(arm: str, position: dict[str, float]) -> dict[str, float]:
    for joint in urdf(arm).iter("joint"):
        if (mimic := joint.find("mimic")) is not None:
            led = position[mimic.attrib["joint"]] * float(mimic.attrib["multiplier"])
            position = position | {joint.attrib["name"]: led}
    return position


def lowest_m(model: mujoco.MjModel, data: mujoco.MjData) -> dict[str, float]:
    """Return the height of the lowest point of each link's boxes and cylinders."""
    heights: dict[str, float] = {}
    for index in range(model.ngeom):
        down, size = np.abs(data.geom_xmat[index].reshape(3, 3)[2]), model.geom_size[index]
        if model.geom_type[index] == mujoco.mjtGeom.mjGEOM_BOX:
            reach = down @ size
        else:
            assert model.geom_type[index] == mujoco.mjtGeom.mjGEOM_CYLINDER
            reach = down[2] * size[1] + np.hypot(down[0], down[1]) * size[0]
        link = model.body(model.geom_bodyid[index]).name
        height = float(data.geom_xpos[index][2] - reach)
        heights[link] = min(heights.get(link, height), height)
    return heights


def test_sixteen_arm_models_are_shipped():
    assert len(ARMS) == 16


@pytest.mark.parametrize("arm", ARMS)
def test_arm_file_name_equals_its_folder(arm):
    assert read(arm)["name"] == arm


@pytest.mark.parametrize("arm", ARMS)
def test_arm_file_has_its_urdf_beside_it(arm):
    assert (CONFIGS / arm / read(arm)["urdf"]).is_file()


@pytest.mark.parametrize("arm", ARMS)
def test_arm_file_tip_is_a_link_of_the_urdf(arm):
    assert read(arm)["tip"] in {link.attrib["name"] for link in urdf(arm).iter("link")}


@pytest.mark.parametrize("arm", ARMS)
def test_arm_file_lists_every_driven_joint_from_base_to_tip(arm):
    assert [joint["name"] for joint in read(arm)["joints"]] == list(limits(arm))


@pytest.mark.parametrize("arm", ARMS)
def test_only_joint_named_gripper_has_gripper_role(arm):
    for joint in read(arm)["joints"]:
        assert (joint["role"] == "gripper") == (joint["name"] == "gripper")


@pytest.mark.parametrize("arm", ARMS)
def test_arm_file_has_metres_per_turn_for_sliding_joints_only(arm):
    for joint in read(arm)["joints"]:
        assert ("m_per_turn" in joint["servo"]) == (joint["name"] not in turns(arm))


@pytest.mark.parametrize("arm", ARMS)
def test_arm_file_servo_ids_are_unique(arm):
    ids = [servo["id"] for servo in servos(arm)]
    assert len(ids) == len(set(ids))


@pytest.mark.parametrize("arm", ARMS)
def test_arm_file_servos_belong_to_the_family_of_the_bus(arm):
    families = {"S": "feetech_sts", "X": "dynamixel_2"}
    assert {families[servo["model"][0]] for servo in servos(arm)} == {read(arm)["bus"]["family"]}


@pytest.mark.parametrize("arm", ARMS)
def test_arm_file_limits_lie_inside_the_servo_position_limits(arm):
    for joint in read(arm)["joints"]:
        for servo in (joint["servo"], *joint.get("shadows", [])):
            eeprom = servo.get("eeprom", {})
            low, high = sorted(ticks(servo, limit) for limit in limits(arm)[joint["name"]])
            assert low >= eeprom.get("min_position_limit", 0), joint["name"]
            assert high <= eeprom.get("max_position_limit", 4095), joint["name"]


@pytest.mark.parametrize("arm", ARMS)
def test_second_servo_of_joint_has_first_id_as_secondary_id(arm):
    for joint in read(arm)["joints"]:
        for shadow in joint.get("shadows", []):
            assert shadow["eeprom"]["secondary_id"] == joint["servo"]["id"]


@pytest.mark.parametrize("arm", ARMS)
def test_second_servo_of_joint_turns_opposite_to_first(arm):
    for joint in read(arm)["joints"]:
        for shadow in joint.get("shadows", []):
            reversed_ = [s["eeprom"]["drive_mode"] & 1 for s in (joint["servo"], shadow)]
            assert sorted(reversed_) == [0, 1]


def test_only_six_interbotix_arms_have_two_servos_on_a_joint():
    shadows = {arm: sum(len(j.get("shadows", [])) for j in read(arm)["joints"]) for arm in ARMS}
    assert {arm: n for arm, n in shadows.items() if n} == {
        "px150": 2, "rx200": 1, "vx250": 1, "vx300s": 2, "wx200": 1, "wx250s": 2,
    }  # fmt: skip


@pytest.mark.parametrize("arm", ARMS)
def test_arm_file_speeds_increase_from_slow_to_fast(arm):
    speeds = [read(arm)["speeds"][name] for name in ("slow", "normal", "fast")]
    for slower, faster in pairwise(speeds):
        assert all(slower[key] < faster[key] for key in ("deg_s", "deg_s2", "deg_s3"))


@pytest.mark.parametrize("arm", ARMS)
def test_fast_speed_is_below_70_percent_of_slowest_joint_limit(arm):
    joints = [j for j in urdf(arm).iter("joint") if j.attrib["name"] in turns(arm)]
    slowest_rad_s = min(float(joint.find("limit").attrib["velocity"]) for joint in joints)
    assert np.deg2rad(read(arm)["speeds"]["fast"]["deg_s"]) < 0.7 * slowest_rad_s


@pytest.mark.parametrize("arm", ARMS)
def test_arm_file_pose_gives_every_joint_in_its_unit(arm):
    turning = [name for name in limits(arm) if name in turns(arm)]
    sliding = [name for name in limits(arm) if name not in turning]
    for pose in POSES:
        tables = read(arm)["poses"][pose]
        assert list(tables["deg"]) == turning, pose
        assert list(tables.get("m", {})) == sliding, pose


@pytest.mark.parametrize("arm", ARMS)
def test_arm_file_pose_lies_inside_the_limits(arm):
    for pose in POSES:
        for name, position in positions(arm, pose).items():
            lower, upper = limits(arm)[name]
            assert lower <= position <= upper, (pose, name)


@pytest.mark.parametrize("arm", ARMS)
def test_zero_pose_is_zero_clipped_to_joint_limits(arm):
    for name, position in positions(arm, "zero").items():
        assert position == np.clip(0.0, *limits(arm)[name]), name


@pytest.mark.parametrize("arm", ARMS)
def test_named_pose_has_no_link_below_the_table(arm):
    for pose in POSES:
        for link, height_m in lowest_m(*posed(arm, pose)).items():
            assert height_m > -1e-9, (pose, link)


@pytest.mark.parametrize("arm", [arm for arm in ARMS if not arm.startswith("planar")])
def test_rest_pose_holds_tool_low_above_table(arm):
    tip_m = posed(arm, "rest")[1].body(read(arm)["tip"]).xpos[2]
    highest_m = posed(arm, "zero")[1].body(read(arm)["tip"]).xpos[2]
    assert 0.0 <= tip_m < 0.5 * highest_m


@pytest.mark.parametrize("arm", ARMS)
def test_named_pose_has_no_self_collision(arm):
    for pose in POSES:
        model, data = posed(arm, pose)
        for contact in data.contact[: data.ncon]:
            pair = [int(model.geom_bodyid[geom]) for geom in contact.geom]
            neighbours = {(model.body_parentid[b], b) for b in pair}
            assert tuple(pair) in neighbours or tuple(pair[::-1]) in neighbours, pose
