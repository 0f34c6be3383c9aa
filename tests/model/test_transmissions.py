"""A gear, a rack or a crank between a horn and its joint."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from ikservo.errors import FileFormatError
from ikservo.model import Model, load_model

RACK = "m_per_turn = 0.0722"
CRANK = "crank = { radius_m = 0.022, rod_m = 0.036, zero_deg = 90.0 }"
SHOULDER = "sign = -1, zero_tick = 2048.5"


@pytest.fixture
def loaded(tmp_path: Path, arm_text: str, urdf_text: str):
    def load(old: str, new: str) -> Model:
        assert old in arm_text
        folder = tmp_path / "small"
        folder.mkdir()
        (folder / "arm.urdf").write_text(urdf_text)
        (folder / "arm.toml").write_text(arm_text.replace(old, new, 1))
        return load_model(folder / "arm.toml")

    return load


def test_gear_ratio_2_halves_joint_angle_per_horn_turn(loaded) -> None:
    joint = loaded(SHOULDER, f"{SHOULDER}, gear = 2.0").joint("shoulder")
    assert joint.travel_per_turn == pytest.approx(math.pi)
    assert joint.joint_map.position(2048.5 - 1024) == pytest.approx(math.pi / 4)


def test_rack_moves_joint_by_configured_metres_per_turn(loaded) -> None:
    joint = loaded(RACK, RACK).joint("gripper")
    assert joint.travel_per_turn == pytest.approx(0.0722)
    assert joint.joint_map.position(2048 + 1024) == pytest.approx(0.0722 / 4)


def test_crank_moves_joint_along_crank_curve(loaded) -> None:
    joint_map = loaded(RACK, CRANK).joint("gripper").joint_map
    turned = math.radians(30.0)
    reach = 0.022 * math.cos(math.pi / 2 - turned) + math.sqrt(
        0.036**2 - (0.022 * math.sin(math.pi / 2 - turned)) ** 2
    )
    rest = math.sqrt(0.036**2 - 0.022**2)
    assert joint_map.position(2048 + 4096 / 12) == pytest.approx(reach - rest)


@pytest.mark.parametrize(
    ("new", "where"),
    [
        (f"{RACK}, {CRANK}", "joints[2].servo"),
        (f"{RACK}, gear = 2.0", "joints[2].servo"),
        (CRANK.replace("0.022", "0.040"), "joints[2].servo.crank.radius_m"),
        (CRANK.replace("90.0", "180.0"), "joints[2].servo.crank.zero_deg"),
    ],
)
def test_invalid_transmission_is_reported_with_its_key(loaded, new: str, where: str) -> None:
    with pytest.raises(FileFormatError) as caught:
        loaded(RACK, new)
    assert caught.value.where == where
