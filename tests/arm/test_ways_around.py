"""Motions go around an obstacle on the straight path, unless they must be straight."""

import math
import re
import time
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

import ikservo
from ikservo.errors import BadValueError, CollisionError, InputError, StoppedError
from ikservo.guard import KeepOutBox
from ikservo.guard.path_search import WaySearch
from ikservo.kernels.compiled import is_compiled
from ikservo.kinematics.se3 import exp_so3
from ikservo.model.tool import tool_frame
from ikservo.planning import preflight_planner
from ikservo.planning.motions import MoveTo, motion_fields, parse_motion
from tests.apps.teaching.test_contact_at_start import refusal_of_home
from tests.arm.simulated import call_before, context_of, line_of, registers

POST = KeepOutBox("the post", (0.15, -0.02, 0.0), (0.30, 0.02, 0.25))
LEFT, RIGHT = (0.2, 0.12, 0.1), (0.2, -0.12, 0.1)


@contextmanager
def left_of(post):
    """Yield an arm that stands to the left of a post."""
    with ikservo.open_arm("so101", port="sim:?pose=home") as arm:
        joints = dict(zip(arm.joint_names, arm.plan_to(LEFT).goal.tolist(), strict=True))
    model = replace(ikservo.load_model("so101"), keep_out=(post,))
    with ikservo.open_arm(model, port="sim") as arm:
        for joint, position in joints.items():
            line_of(arm).world.place(joint, position)
        arm.enable()
        yield arm


@pytest.fixture(autouse=True)
def _search_time_of_interpreted_kernels(monkeypatch):
    """Let a search with interpreted kernels, which are much slower, take 100 times as long."""
    if not is_compiled():
        monkeypatch.setattr(preflight_planner, "perf_counter", lambda: time.perf_counter() / 100.0)


@pytest.fixture
def beside_post():
    """An arm to the left of a post, which is as high as its elbow."""
    with left_of(POST) as arm:
        yield arm


def nearest_m(arm, postures):
    context = context_of(arm)
    return context.collision.distances(context.index.body_joints(np.array(postures))).min()


def test_path_avoids_post_with_clearance(beside_post):
    plan = beside_post.plan_to(RIGHT)
    assert "would touch the post" in plan.around
    postures = plan.sample(0.005).positions
    assert 0.0 < plan.clearance_m <= nearest_m(beside_post, postures) + 1e-3
    assert plan.path_m > 0.24
    assert plan.planning_s > 0.0
    again = beside_post.plan_to(RIGHT).sample(0.005).positions
    np.testing.assert_array_equal(postures, again)
    seen = []
    report = beside_post.move_to(RIGHT, on_progress=lambda now: seen.append(now.joints_rad))
    assert report.reached
    assert nearest_m(beside_post, seen) > 0.0


# A random scene, mm, in which a way is nowhere further than 2 mm from things.
NARROW_MM = [
    ((-40, -144, 6), (67, -103, 58)), ((216, 121, 9), (319, 172, 129)),
    ((-42, -185, 199), (46, -69, 286)), ((16, 28, 34), (132, 126, 128)),
    ((82, 212, 203), (168, 301, 255)),
]  # fmt: skip


def test_narrow_free_path_between_boxes_is_found():
    start = [1.759, -0.326, -1.055, 1.227, 0.339, 0.692]
    goal = [1.579, 1.271, -0.982, -1.422, -0.087, 1.103]
    boxes = tuple(
        KeepOutBox(f"box {i}", *(tuple(np.array(corner) / 1e3) for corner in each))
        for i, each in enumerate(NARROW_MM)
    )
    with ikservo.open_arm(replace(ikservo.load_model("so101"), keep_out=boxes), port="sim") as arm:
        for joint, position in zip(arm.joint_names, start, strict=True):
            line_of(arm).world.place(joint, position)
        arm.enable()
        plan = arm.plan_joints(dict(zip(arm.joint_names, goal, strict=True)))
        assert plan.around
        assert 0.0 < nearest_m(arm, plan.sample(0.005).positions) < 0.003


@pytest.mark.full
def test_joint_goals_are_reached_around_obstacles(beside_post):
    goal = dict(zip(beside_post.joint_names, beside_post.plan_to(RIGHT).goal.tolist(), strict=True))
    assert beside_post.move_joints(goal).reached
    beside_post.move_to(LEFT)
    with pytest.raises(CollisionError, match="the post"):
        beside_post.move_joints(goal, straight=True)
    others = {name: at for name, at in goal.items() if name != "wrist_roll"}
    with pytest.raises(CollisionError, match="the post"):
        beside_post.move_joints(others)  # the one that is not named stays


def test_blocked_line_is_refused_and_joint_move_is_suggested(beside_post):
    before = registers(beside_post, "goal_position")
    with pytest.raises(CollisionError, match=r"would touch the post: .* mm deep") as refused:
        beside_post.move_line(RIGHT)
    assert "ikservo move 0.200 -0.120 0.100" in refused.value.command_hint
    assert registers(beside_post, "goal_position") == before


def test_joint_goal_inside_an_obstacle_is_refused(beside_post):
    with pytest.raises(CollisionError, match="the post"):
        beside_post.plan_to((0.22, 0.0, 0.1))


def test_straight_motion_through_post_is_refused(beside_post):
    with pytest.raises(CollisionError, match="the post"):
        beside_post.move_to(RIGHT, straight=True)


def test_straight_option_is_serialised_with_motion():
    assert parse_motion(motion_fields(MoveTo(LEFT, straight=True))) == MoveTo(LEFT, straight=True)
    assert motion_fields(MoveTo(LEFT)) == {"move_to": {"position_m": list(LEFT)}}


def test_planner_finds_several_goals_for_one_point():
    with ikservo.open_arm("wx250s", port="sim:?pose=home") as arm:
        planner, at = context_of(arm).planner, np.array(list(arm.where().positions.values()))
        tip_m = planner.tip(at)
        found = planner.goals_at(at, tip_m, ikservo.ToolOrientation())
        assert len(found) > 3
        for each in found:
            np.testing.assert_allclose(planner.tip(each.joints), tip_m, atol=2e-5)
        level = planner.goals_at(at, tip_m, ikservo.ToolOrientation(pitch_rad=0.0))
        turned = {round(each.joints[arm.joint_names.index("forearm_roll")], 1) for each in level}
        assert len(turned) > 1
        assert max(each.solved.orientation_error_rad for each in level) < 0.01


def test_tool_tolerance_lets_arm_reach_point_under_obstacle():
    straight_down = ikservo.ToolOrientation(pitch_rad=-math.pi / 2)
    tilted = replace(straight_down, within_rad=math.radians(20.0))
    with ikservo.open_arm("so101", port="sim:?pose=home") as arm:
        arm.scene.add("sphere", "the lamp", centre_m=(0.24, 0.0, 0.13), radius_m=0.015)
        with pytest.raises(CollisionError, match="the lamp"):
            arm.plan_to((0.22, 0.0, 0.06), stance=straight_down)
        plan = arm.plan_to((0.22, 0.0, 0.06), stance=tilted)
        down = (
            context_of(arm).planner.tip_pose(plan.goal)[2, :3] @ tool_frame(arm.model).approach_axis
        )
        assert math.radians(1.0) < math.acos(-down) <= math.radians(20.0)
        assert plan.orientation_error_rad == pytest.approx(math.acos(-down))
        arm.scene.remove("the lamp")
        assert arm.plan_to((0.22, 0.0, 0.06), stance=tilted).orientation_error_rad < 0.01


@pytest.mark.parametrize(
    "wanted",
    [
        {"pitch_rad": -1.2},
        {"pitch_rad": -0.4, "roll_rad": 0.3},
        {"direction": (0.3, 0.1, -1.0)},
        {"orientation": exp_so3(np.array([0.1, 1.2, 0.2]))},
    ],
)
def test_planned_goals_use_but_do_not_exceed_tool_tolerance(wanted):
    stance, most_rad = ikservo.ToolOrientation(**wanted, within_rad=0.25), 0.25
    with ikservo.open_arm("wx250s", port="sim:?pose=home") as arm:
        planner, tool = context_of(arm).planner, tool_frame(arm.model)
        start = np.array(list(arm.where().positions.values()))
        found = planner.goals_at(start, (0.3, 0.05, 0.2), stance)
        errors = [each.solved.orientation_error_rad for each in found]
        assert errors[0] < 0.01
        assert 0.1 < max(errors) <= most_rad
        for each in found:
            R = planner.tip_pose(each.joints)[:3, :3]
            if "pitch_rad" in wanted:
                assert abs(tool.pitch_rad(R) - wanted["pitch_rad"]) <= most_rad
            if "direction" in wanted:
                towards = np.array(wanted["direction"]) / np.linalg.norm(wanted["direction"])
                assert towards @ R @ tool.approach_axis >= math.cos(most_rad)
            if "orientation" in wanted:
                assert np.trace(R.T @ wanted["orientation"]) >= 1.0 + 2.0 * math.cos(most_rad)


@pytest.mark.parametrize("wrong", [{"within_rad": 0.2}, {"keep": True, "within_rad": 0.2},
    {"pitch_rad": 0.0, "within_rad": 0.0}, {"pitch_rad": 0.0, "within_rad": math.nan},
    {"pitch_rad": 0.0, "within_rad": 4.0}])  # fmt: skip
def test_invalid_tool_tolerance_is_refused(wrong):
    with pytest.raises(InputError, match=r"[Tt]he tolerance"):
        ikservo.ToolOrientation(**wrong)


def test_stop_ends_path_search_and_nothing_moves(monkeypatch, beside_post):
    before = registers(beside_post, "goal_position")
    call_before(WaySearch, "find", monkeypatch, beside_post.stop)
    with pytest.raises(StoppedError, match="Stopped by the program"):
        beside_post.move_to(RIGHT)
    beside_post.acknowledge()
    assert registers(beside_post, "goal_position") == before


def test_refused_path_search_reports_its_search_time(monkeypatch, beside_post):
    monkeypatch.setattr(WaySearch, "find", lambda *_: time.sleep(0.06))
    with pytest.raises(CollisionError, match="the post") as refused:
        beside_post.plan_to(RIGHT, think_s=0.05)
    assert "No path around it was found in 0.05 s; --think 0.15s" in refused.value.command_hint


def test_refused_path_search_reports_why_it_ended(monkeypatch, beside_post):
    with pytest.raises(CollisionError, match="the post") as refused:
        beside_post.plan_to((0.22, 0.0, 0.1))
    assert "something in every posture at the target" in refused.value.command_hint
    monkeypatch.setattr(WaySearch, "find", lambda search, *_: setattr(search, "has_ended", True))
    with pytest.raises(CollisionError, match="the post") as refused:
        beside_post.plan_to(RIGHT)
    assert re.search(r"A search of [0-9.]+ s found no path around", refused.value.command_hint)


def test_planning_time_is_serialised_with_motion():
    motion = MoveTo(LEFT, think_s=10.0)
    assert parse_motion(motion_fields(motion)) == motion
    with pytest.raises(BadValueError, match="time to search for a path"):
        MoveTo(LEFT, think_s=0.0)


@pytest.mark.sample(1)
@pytest.mark.parametrize(("name", "seed"), [("px100", 12), ("wx250s", 2)])
def test_limp_arm_moves_from_contact_to_home_pose(name, seed):
    assert refusal_of_home(name, seed) is None
