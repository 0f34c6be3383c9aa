"""Direction, pitch and roll of a tool, with one convention for all arms."""

import itertools
import math

import numpy as np
import pytest

from ikservo.kinematics.se3 import exp_so3
from ikservo.model import load_model
from ikservo.model.tool import tool_frame
from tests.oracle import ARMS

ANGLES = [-1.4, -0.5, 0.0, 0.7, 1.3]


@pytest.mark.parametrize("name", ARMS)
def test_tool_approach_axis_points_away_from_wrist(name):
    model = load_model(name)
    q, h = model.chain_pose("home"), 1e-6
    T = model.chain.forward(q)
    tool = tool_frame(model)
    ahead_m = T[:3, 3] + 0.05 * T[:3, :3] @ tool.approach_axis
    wrist = [i for i in range(model.chain.dof) if moves_m(model, q, i, h) > 0.03 * h][-1]
    further = model.chain.jacobian(q, offset_m=0.05 * tool.approach_axis)[:3, wrist]
    assert np.linalg.norm(further) > np.linalg.norm(model.chain.jacobian(q)[:3, wrist])
    assert ahead_m.shape == (3,)


def moves_m(model, q, joint, step):
    moved = q.copy()
    moved[joint] += step
    return float(np.linalg.norm(model.chain.forward(moved)[:3, 3] - model.chain.forward(q)[:3, 3]))


@pytest.mark.parametrize("name", ["so101", "koch", "open_manipulator_x", "wx250s"])
def test_tool_angles_round_trip_through_rotation(name):
    tool = tool_frame(load_model(name))
    for pitch, roll in itertools.product(ANGLES, ANGLES):
        R = tool.rotation(0.4, pitch, roll)
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
        angles = (tool.heading_rad(R), tool.pitch_rad(R), tool.roll_rad(R, 0.0))
        assert angles == pytest.approx((0.4, pitch, roll))


def test_tool_straight_down_has_pitch_minus_90_and_no_heading():
    tool = tool_frame(load_model("so101"))
    R = tool.rotation(0.4, -math.pi / 2, 0.3)
    assert tool.pitch_rad(R) == pytest.approx(-math.pi / 2)
    assert tool.heading_rad(R) is None
    assert tool.roll_rad(R, 0.4) == pytest.approx(0.3)


def test_positive_tool_roll_is_clockwise_from_behind():
    tool = tool_frame(load_model("open_manipulator_x"))
    level = tool.rotation(0.0, 0.0, 0.0)
    rolled = exp_so3(0.2 * level @ tool.approach_axis) @ level
    assert tool.roll_rad(rolled, 0.0) == pytest.approx(0.2)


@pytest.mark.parametrize("name", ["so100", "so101", "koch", "omx_f", "px100", "wx250s"])
def test_home_pose_has_no_tool_roll(name):
    model = load_model(name)
    R = model.chain.forward(model.chain_pose("home"))[:3, :3]
    assert abs(tool_frame(model).roll_rad(R, 0.0)) < math.radians(3)
