"""Constraints of the tool along a path: straight paths are checked, others are searched."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest

import ikservo
from ikservo.errors import BadValueError, ConstraintError
from ikservo.guard import KeepOutBox
from ikservo.kernels import compiled, tool_limits
from ikservo.model.tool import tool_frame
from ikservo.planning.motions import MoveJoints, MoveLine, MoveTo, motion_fields, parse_motion
from ikservo.planning.path_constraint import ConstrainedTool, PathConstraint
from ikservo.planning.poses import PoseLibrary
from ikservo.planning.preflight_planner import PlannedStart, PreflightPlanner
from tests.arm.simulated import context_of, registers
from tests.arm.test_ways_around import LEFT, RIGHT, left_of
from tests.both_ways import needs_extension

UPRIGHT = PathConstraint(upright_rad=math.radians(10.0))
# The joints swing the tip out to x = 0.23 m between two points at x = 0.2 m.
NEAR = PathConstraint(low_m=(0.05, -0.2, 0.02), high_m=(0.215, 0.2, 0.3))


@pytest.fixture
def ready():
    with ikservo.open_arm("so101", port="sim:?pose=home") as arm:
        arm.move_to(LEFT)
        yield arm


def poses_along(arm, plan):
    context = context_of(arm)
    return context.chain.forward(context.index.chain_joints(plan.sample(0.005).positions))


def tilts_deg(poses):
    """Return the tilt of the axis that pointed up in the gripper at the start, degrees."""
    up = poses[:, :3, :3] @ poses[0, 2, :3]
    return np.degrees(np.arccos(np.clip(up[:, 2], -1.0, 1.0)))


def test_upright_constraint_is_kept_around_a_block():
    block = KeepOutBox("the block", (0.15, -0.02, 0.0), (0.30, 0.02, 0.12))
    with left_of(block) as arm:
        plan = arm.plan_to(RIGHT, within=UPRIGHT)
        assert "would touch the block" in plan.around
        assert tilts_deg(poses_along(arm, plan)).max() <= 10.1
        assert tilts_deg(poses_along(arm, arm.plan_to(RIGHT))).max() > 12.0
        assert len(plan.kept) == 1
        assert "tilt of the tool" in plan.kept[0]
        assert arm.execute(plan).reached


@pytest.mark.full
def test_path_leaving_allowed_box_is_replaced_by_one_inside(ready):
    plan = ready.plan_to(RIGHT, within=NEAR)
    assert "outside the allowed box" in plan.around
    tips_m = poses_along(ready, plan)[:, :3, 3]
    assert tips_m[:, 0].max() <= 0.2151
    assert "inside the allowed box" in plan.kept[0]
    assert ready.move_to(RIGHT, within=NEAR).reached


def test_joint_space_line_is_used_if_it_alone_keeps_upright():
    start = np.array([-0.2515, -1.4615, 0.1516, 0.4753, 0.0])
    goal = MoveJoints(
        {"joint1": 1.2202, "joint2": -0.6933, "joint3": 0.7451, "joint4": -1.0425},
        within=UPRIGHT,
    )
    with ikservo.open_arm("open_manipulator_x", port="sim") as arm:
        planner = PreflightPlanner(context_of(arm), PlannedStart(start), PoseLibrary(arm.model, ""))
        with pytest.raises(ConstraintError, match=r"11\.\d°, more than"):
            planner.plan(replace(goal, straight=True))
        plan = planner.plan(goal)
        assert "tilt of the tool" in plan.around
        assert tilts_deg(poses_along(arm, plan)).max() <= 10.1
        joints = plan.sample(0.005).positions
        along_rad = np.linalg.norm(np.diff(joints, axis=0), axis=1).sum()
        assert along_rad == pytest.approx(np.linalg.norm(joints[-1] - joints[0]), rel=1e-6)


def test_path_constraint_error_names_size_and_place_of_excess(ready):
    before = registers(ready, "goal_position")
    with pytest.raises(ConstraintError, match=r"the tip|The tip") as refused:
        ready.move_to(RIGHT, straight=True, within=NEAR)
    tips_m = poses_along(ready, ready.plan_to(RIGHT))[:, :3, 3]
    assert refused.value.beyond == pytest.approx(tips_m[:, 0].max() - 0.215, abs=1e-3)
    assert re.search("at (49|50|51|52) % of the path", str(refused.value))
    with pytest.raises(ConstraintError, match="allowed half-space, at 0 %"):
        ready.move_to(RIGHT, within=PathConstraint(above_m=(0.0, 0.0, 0.12)))
    wrist = ready.where().positions["wrist_flex"]
    with pytest.raises(ConstraintError, match=r"more than the allowed 10\.0°, at 100 %"):
        ready.move_joints({"wrist_flex": wrist - 0.5}, within=UPRIGHT)
    with pytest.raises(ConstraintError, match="angle of the tool axis"):
        ready.move_joints({"wrist_flex": -0.5}, within=PathConstraint(axis=(0, 0, -1)))
    assert registers(ready, "goal_position") == before


@pytest.mark.full
def test_line_plan_reports_path_constraint(ready):
    plan = ready.plan_line((0.2, 0.0, 0.1), within=UPRIGHT)
    assert tilts_deg(poses_along(ready, plan)).max() <= 10.1
    assert plan.kept
    assert ready.plan_line((0.2, 0.0, 0.1)).kept == ()


def tool_of(name, constraint, start):
    model = ikservo.load_model(name)
    tool = ConstrainedTool(constraint, model.chain, tool_frame(model).approach_axis, start)
    return model.chain, tool


WHOLE = PathConstraint(
    upright_rad=0.3, axis=(1.0, 0.2, -0.5), axis_rad=0.9, low_m=(0.05, -0.3, 0.0),
    high_m=(0.4, 0.3, 0.35), above_m=(0.0, 0.0, 0.05), normal=(0.1, 0.0, 1.0),
)  # fmt: skip


@pytest.mark.parametrize("name", ["so101", "wx250s"])
def test_path_constraint_violation_between_samples_is_found(name):
    chain, tool = tool_of(name, WHOLE, np.zeros(ikservo.load_model(name).chain.dof))
    random, broken = np.random.default_rng(4), 0
    for _ in range(60):
        inside = [tool.project(q) for q in random.uniform(-0.6, 0.6, (2, chain.dof))]
        if inside[0] is None or inside[1] is None:
            continue
        ends = np.array(inside)
        dense = tool.excess(np.linspace(*ends, 800))
        assert (np.abs(np.diff(dense[[0, -1]], axis=0)) <= tool._changes(ends) + 1e-9).all()
        if dense.max() <= 0.0:
            tool.check(ends)
        elif dense.max() > 1.1e-3:
            broken += 1
            with pytest.raises(ConstraintError) as refused:
                tool.check(ends)
            assert dense.max() - 0.005 < refused.value.beyond <= dense.max() + 1e-4
    assert 0 < broken < 50


def test_constraint_projection_keeps_constraint_and_tip_point():
    chain, tool = tool_of("wx250s", WHOLE, np.zeros(6))
    random, found = np.random.default_rng(5), 0
    for q in random.uniform(-0.8, 0.8, (20, 6)):
        inside = tool.project(q)
        assert inside is None or tool.keeps(inside[None])[0]
        there = tool.project(q, np.array([0.25, 0.05, 0.2]))
        if there is not None:
            found += 1
            assert tool.keeps(there[None])[0]
            np.testing.assert_allclose(chain.forward(there)[:3, 3], (0.25, 0.05, 0.2), atol=1e-5)
    assert found > 10


@pytest.mark.parametrize(
    "wrong",
    [
        {"upright_rad": 0.0},
        {"upright_rad": math.nan},
        {"upright_rad": "10"},
        {"axis": (0, 0, 0)},
        {"axis": (0, 0, 1), "axis_rad": 4.0},
        {"low_m": (0, 0, 0)},
        {"low_m": (0, 0, 0), "high_m": (1, 0, 1)},
        {"above_m": (0, 0, math.inf)},
        {"above_m": (0, 0, 0), "normal": (0, 0, 0)},
    ],
)
def test_invalid_path_constraint_is_refused(wrong):
    with pytest.raises(BadValueError):
        PathConstraint(**wrong)


def test_path_constraint_is_serialised_with_motion():
    with pytest.raises(BadValueError, match="within"):
        MoveTo(LEFT, within=10.0)
    for motion in (MoveTo(LEFT, within=WHOLE), MoveLine(LEFT, within=UPRIGHT), MoveTo(LEFT)):
        assert parse_motion(motion_fields(motion)) == motion


@needs_extension
def test_compiled_constraint_projection_equals_python_code(monkeypatch):
    start, q = np.zeros(6), np.array([0.4, -0.3, 0.5, 0.2, -0.6, 0.1])
    point_m = np.array([0.25, 0.05, 0.2])
    _, tool = tool_of("wx250s", WHOLE, start)
    found = [tool.project(q), tool.project(q, point_m), tool.excess(q[None])]
    for name in ("tool_poses", "project_tool"):
        monkeypatch.setattr(tool_limits, name, compiled.uncompiled[name])
    again = [tool.project(q), tool.project(q, point_m), tool.excess(q[None])]
    for one, other in zip(found, again, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("length", [1e200, 1e7, 1e-9])
def test_path_constraint_direction_of_extreme_length_is_refused(length):
    with pytest.raises(BadValueError):
        PathConstraint(above_m=(0.0, 0.0, 0.1), normal=(0.0, 0.0, length))
    with pytest.raises(BadValueError):
        PathConstraint(axis=(length, 0.0, 0.0))
