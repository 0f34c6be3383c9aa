"""Gears, racks and cranks of arm files: the horn turns, the joint follows."""

import math

import pytest

import ikservo
from servosim import read_arm_file
from servosim.assembly import make_arm_world
from servosim.joint import CrankAndRod, Ratio
from tests.arm.simulated import line_of
from tests.oracle import CONFIGS

CRANK = CrankAndRod(0.01, 0.03, math.radians(60))


def test_crank_at_right_angle_matches_pythagoras():
    crank = CrankAndRod(3.0, 5.0, math.pi / 2)
    assert crank.position(math.pi / 2) == pytest.approx(3.0 + 5.0 - 4.0)
    assert crank.position(-math.pi / 2) == pytest.approx(5.0 - 3.0 - 4.0)


@pytest.mark.parametrize("horn_rad", [-1.5, -0.5, 0.0, 0.4, 0.9])
def test_crank_horn_angle_inverts_position(horn_rad):
    assert CRANK.horn_rad(CRANK.position(horn_rad)) == pytest.approx(horn_rad)


def test_crank_slope_equals_finite_difference():
    h = 1e-6
    slope = (CRANK.position(0.3 + h) - CRANK.position(0.3 - h)) / (2 * h)
    assert CRANK.slope(0.3) == pytest.approx(slope, rel=1e-6)


def test_crank_position_out_of_range_gives_dead_centre():
    assert CRANK.horn_rad(1.0) == pytest.approx(math.radians(60))


def test_transmission_ratio_without_gear_is_1():
    assert (Ratio().position(0.3), Ratio().horn_rad(0.3), Ratio().is_prismatic) == (
        0.3,
        0.3,
        False,
    )


def arm_with(tmp_path, name, old, new):
    """Write an arm's files with another transmission; return the arm file."""
    for file in ("arm.toml", "arm.urdf"):
        (tmp_path / file).write_text((CONFIGS / name / file).read_text())
    text = (tmp_path / "arm.toml").read_text()
    assert old in text
    (tmp_path / "arm.toml").write_text(text.replace(old, new, 1))
    return tmp_path / "arm.toml"


@pytest.mark.full
def test_horn_of_geared_joint_turns_further_than_joint(tmp_path):
    path = arm_with(tmp_path, "planar2", "zero_tick = 2048 }", "zero_tick = 2048, gear = 1.5 }")
    with ikservo.open_arm(path, port="sim", collisions=False) as arm:
        arm.move_joints({"joint1": 0.6})
        line = line_of(arm)
        assert line.world.joint("joint1").position == pytest.approx(0.6, abs=0.01)
        ticks = line.servos[1].read("present_position") - 2048
        assert abs(ticks) * math.tau / 4096 == pytest.approx(1.5 * 0.6, abs=0.015)


def test_cranked_prismatic_joint_starts_in_pose_and_moves(tmp_path):
    path = arm_with(
        tmp_path, "open_manipulator_x", "m_per_turn = ",
        "crank = { radius_m = 0.02, rod_m = 0.05, zero_deg = 90.0 } #",
    )  # fmt: skip
    text = path.read_text()
    line = next(line for line in text.splitlines() if "crank" in line)
    path.write_text(text.replace(line, line.partition("#")[0] + "}"))
    arm = read_arm_file(path)
    world = make_arm_world(arm, "home")
    assert world.joint("gripper").position == pytest.approx(arm.poses["home"]["gripper"])
    assert world.joint("gripper").is_prismatic
    with ikservo.open_arm(path, port="sim", collisions=False) as machine:
        machine.move_joints({"gripper": -0.008})
        gripper = line_of(machine).world.joint("gripper")
        assert gripper.position == pytest.approx(-0.008, abs=4e-4)
