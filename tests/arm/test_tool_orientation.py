"""Tool orientation at a point: as requested, or as close as the arm can keep it."""

import math
from functools import cache

import numpy as np
import pytest

import ikservo
from ikservo.errors import BadValueError, OrientationError, UnknownNameError, UnreachableError
from ikservo.kinematics import JointIndex
from ikservo.kinematics.se3 import log_so3
from ikservo.model import load_model
from ikservo.model.tool import tool_frame
from ikservo.planning.planner import Planner
from ikservo.planning.tool_orientation import ToolOrientation

DEG = math.radians


@cache
def bench(name):
    """Return an arm's planner, chain, tool, and its joints at home."""
    model = load_model(name)
    names = [joint.name for joint in model.joints]
    here = np.array([model.pose("home")[joint] for joint in names])
    index = JointIndex.from_names(names, model.chain.names)
    return Planner(model, model.chain, index), model.chain, tool_frame(model), here


def planned(name, point_m, **asked):
    """Plan from home; return the plan and the tool's orientation there (3, 3)."""
    planner, chain, _, here = bench(name)
    plan = planner.plan_to_point(here, point_m, "normal", ToolOrientation(**asked))
    return plan, chain.forward(plan.goal[: chain.dof])[:3, :3]


@pytest.mark.parametrize("name", ["so101", "open_manipulator_x", "px100", "omx_f", "wx250s"])
@pytest.mark.parametrize("degrees", [-70, -60, -45])
def test_reachable_tool_pitch_is_reached_within_0_1_degrees(name, degrees):
    plan, R = planned(name, (0.2, 0.04, 0.08), pitch_rad=DEG(degrees))
    assert math.degrees(bench(name)[2].pitch_rad(R)) == pytest.approx(degrees, abs=0.1)
    np.testing.assert_allclose(plan.tip_m, (0.2, 0.04, 0.08), atol=2e-5)


@pytest.mark.parametrize("name", ["so101", "omx_f", "wx250s"])
def test_tool_pitch_and_roll_are_reached_together(name):
    _, R = planned(name, (0.2, 0.04, 0.08), pitch_rad=DEG(-50), roll_rad=DEG(25))
    tool = bench(name)[2]
    assert math.degrees(tool.pitch_rad(R)) == pytest.approx(-50, abs=0.1)
    assert math.degrees(tool.roll_rad(R, 0.0)) == pytest.approx(25, abs=0.5)


def test_requested_tool_roll_keeps_tool_pitch():
    _, chain, tool, here = bench("so101")
    _, R = planned("so101", (0.2, 0.04, 0.12), roll_rad=DEG(40))
    before = tool.pitch_rad(chain.forward(here[: chain.dof])[:3, :3])
    assert math.degrees(tool.roll_rad(R, 0.0)) == pytest.approx(40, abs=0.5)
    assert math.degrees(tool.pitch_rad(R)) == pytest.approx(math.degrees(before), abs=1.0)


def test_tool_direction_is_reached_by_arm_with_free_wrist():
    _, R = planned("wx250s", (0.2, 0.04, 0.15), direction=(1, 0.5, -1))
    np.testing.assert_allclose(
        R @ bench("wx250s")[2].approach_axis, np.array((1, 0.5, -1)) / 1.5, atol=1e-3
    )


def test_keep_option_keeps_tool_orientation_in_base_frame():
    _, chain, _, here = bench("wx250s")
    _, R = planned("wx250s", (0.22, 0.06, 0.2), keep=True)
    before = chain.forward(here[: chain.dof])[:3, :3]
    assert math.degrees(np.linalg.norm(log_so3(R @ before.T))) < 0.1


@pytest.mark.parametrize("name", ["so101", "omx_f", "open_manipulator_x", "px100"])
def test_tool_keeps_its_pitch_if_no_orientation_is_given(name):
    _, chain, tool, here = bench(name)
    point_m = chain.forward(here[: chain.dof])[:3, 3] + np.array((-0.02, 0.05, 0.02))
    plan, R = planned(name, point_m)
    before = chain.forward(here[: chain.dof])[:3, :3]
    assert tool.pitch_rad(R) == pytest.approx(tool.pitch_rad(before), abs=DEG(0.2))
    assert math.degrees(plan.orientation_error_rad) < 0.2


def test_unkeepable_orientation_does_not_prevent_reaching_point():
    plan, _ = planned("so101", (0.02, 0.02, 0.45))
    np.testing.assert_allclose(plan.tip_m, (0.02, 0.02, 0.45), atol=2e-5)
    assert math.degrees(plan.orientation_error_rad) > 5.0


@pytest.mark.parametrize(("name", "asked", "word"), [
    ("open_manipulator_x", {"roll_rad": DEG(20)}, "roll 20.0°"),
    ("so101", {"pitch_rad": DEG(60)}, "pitch 60.0°"),
    ("so101", {"keep": True}, "the present orientation"),
    ("px100", {"direction": (0, 1, 0)}, "direction 0,1,0"),
])  # fmt: skip
def test_impossible_orientation_error_suggests_possible_pitch(name, asked, word):
    with pytest.raises(OrientationError, match="is not possible") as caught:
        planned(name, (0.2, 0.06, 0.12), **asked)
    error = caught.value
    assert word in error.message
    assert error.left_rad > DEG(0.5)
    assert "pitch" in error.instead


def test_suggested_tool_pitch_can_be_planned():
    with pytest.raises(OrientationError) as caught:
        planned("so101", (0.2, 0.06, 0.12), pitch_rad=DEG(60))
    offered = float(caught.value.instead.split("pitch ")[1].split("°")[0])
    planned("so101", (0.2, 0.06, 0.12), pitch_rad=DEG(offered))


def test_point_out_of_reach_does_not_raise_orientation_error():
    with pytest.raises(UnreachableError, match="cannot be reached"):
        planned("so101", (0.9, 0.0, 0.1), pitch_rad=0.0)


@pytest.mark.parametrize("asked", [
    {"pitch_rad": 2.0}, {"pitch_rad": math.nan}, {"roll_rad": 7.0}, {"roll_rad": math.inf},
    {"direction": (0, 0, 0)}, {"direction": (1, math.nan, 0)}, {"direction": (1, 0)},
    {"keep": True, "pitch_rad": 0.1}, {"direction": (1, 0, 0), "pitch_rad": 0.1},
])  # fmt: skip
def test_invalid_tool_orientation_is_refused(asked):
    with pytest.raises(BadValueError):
        ToolOrientation(**asked)


def test_line_turns_tool_to_requested_pitch_at_its_end():
    planner, chain, tool, here = bench("so101")
    goal_m = chain.forward(here[: chain.dof])[:3, 3] + np.array((-0.02, 0.05, 0.03))
    plan = planner.plan_linear(here, [goal_m], "normal", 0.02, ToolOrientation(pitch_rad=DEG(-40)))
    R = chain.forward(plan.goal[: chain.dof])[:3, :3]
    assert math.degrees(tool.pitch_rad(R)) == pytest.approx(-40, abs=0.5)


@pytest.fixture
def arm():
    with ikservo.open_arm("so101", port="sim") as machine:
        yield machine


@pytest.mark.parametrize("stance", [None, "down", (0.0, 0.0, -1.0)])
def test_move_refuses_stance_argument_of_wrong_type(arm, stance):
    with pytest.raises(BadValueError, match="ToolOrientation"):
        arm.move_to((0.2, 0.0, 0.15), stance=stance)
    with pytest.raises(BadValueError, match="ToolOrientation"):
        arm.move_line((0.2, 0.0, 0.15), stance=stance)


def test_tool_pitch_that_is_not_a_number_is_refused():
    with pytest.raises(BadValueError, match="The pitch"):
        ToolOrientation(pitch_rad="down")


@pytest.mark.parametrize("speed", [[], None, 1, "quick"])
def test_invalid_speed_error_of_move_to_lists_speeds(arm, speed):
    with pytest.raises(UnknownNameError, match="slow"):
        arm.move_to((0.2, 0.0, 0.15), speed=speed)
