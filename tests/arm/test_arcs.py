"""Arcs, circles and tool speed on a simulated arm, judged at its joints."""

import numpy as np
import pytest

import ikservo
from ikservo.errors import BadValueError, RefusedError, UnreachableError
from tests.arm.simulated import registers, true_tip_m
from tests.oracle import ARMS


def at(x, y, z):
    return np.array([x, y, z], dtype=float)


def held(name):
    """Return an arm that holds its pose home after its first motion, and its tip (3,) [m]."""
    arm = ikservo.open_arm(name, port="sim:?pose=home")
    arm.pose("home")
    return arm, tip_of_reference(arm)


def tip_of_reference(arm):
    reference = arm.context.servos.reference()
    return arm.chain.forward(arm.joint_index.chain_joints(reference))[:3, 3]


@pytest.mark.sample(1)
@pytest.mark.parametrize("name", ARMS)
def test_circle_motion_ends_at_its_start_after_a_full_turn(name):
    arm, tip_m = held(name)
    with arm:
        far = []
        report = arm.move_arc(
            center_m=tip_m - (0.02, 0.0, 0.0),
            tool_speed_m_s=0.04,
            on_progress=lambda p: far.append(np.linalg.norm(p.tip_m - tip_m)),
        )
        assert report.reached
        assert np.linalg.norm(true_tip_m(arm) - tip_m) < 2e-3
        assert max(far) > 0.03  # of the 0.04 m to the opposite side
        assert 0.0 < report.path_error_rms_m <= report.path_error_max_m


@pytest.mark.full
def test_arc_passes_through_its_via_point():
    arm, tip_m = held("open_manipulator_x")
    with arm:
        via, end = tip_m + at(-0.02, 0.03, 0.0), tip_m + at(-0.05, 0.04, 0.01)
        passed = []
        report = arm.move_arc(via, end, on_progress=lambda p: passed.append(p.tip_m))
        assert report.reached
        nearest_m = np.linalg.norm(np.array(passed) - via, axis=1).min()
        assert nearest_m < report.path_error_max_m + 2e-3
        assert np.linalg.norm(true_tip_m(arm) - end) < 2e-3


@pytest.mark.full
def test_plan_states_whether_requested_tool_speed_is_reached():
    arm, tip_m = held("so101")
    with arm:
        slow = arm.plan_line(tip_m + at(-0.04, 0.05, 0.02), tool_speed_m_s=0.03).tool_speed
        assert slow.is_constant
        assert slow.top_m_s == pytest.approx(0.03, rel=0.02)
        quick = arm.plan_line(tip_m + at(-0.04, 0.05, 0.02), tool_speed_m_s=0.24).tool_speed
        assert not quick.is_constant
        assert quick.top_m_s < 0.2
        assert quick.limited_by
        assert str(quick).startswith("at most ")


def test_absurdly_low_tool_speed_of_line_is_refused():
    arm, tip_m = held("so101")
    with arm:
        goals = registers(arm, "goal_position")
        for tool_speed_m_s in (1e-5, 1e-10):
            with pytest.raises(BadValueError, match="The speed of the tool"):
                arm.move_line(tip_m + at(-0.04, 0.05, 0.02), tool_speed_m_s=tool_speed_m_s)
        assert registers(arm, "goal_position") == goals


def test_slow_speed_limits_tool_speed_of_line():
    arm, tip_m = held("so101")
    with arm:
        plan = arm.plan_line(tip_m + at(-0.04, 0.09, 0.05), tool_speed_m_s=0.3, speed="slow")
        assert plan.tool_speed.top_m_s <= 0.1 + 1e-6


@pytest.mark.full
def test_measured_tip_speed_equals_requested_tool_speed():
    arm, tip_m = held("so101")
    with arm:
        seen = []
        plan = arm.plan_line(tip_m + at(-0.05, 0.08, 0.03), tool_speed_m_s=0.02)
        arm.execute(plan, lambda p: seen.append((p.elapsed_s, *p.tip_m)))
    rows = np.array(seen)
    middle = rows[(rows[:, 0] > 0.3 * plan.duration_s) & (rows[:, 0] < 0.7 * plan.duration_s)]
    distance_m = np.linalg.norm(middle[-1, 1:] - middle[0, 1:])
    assert distance_m / (middle[-1, 0] - middle[0, 0]) == pytest.approx(0.02, rel=0.05)


def test_invalid_or_unreachable_arc_moves_nothing():
    arm, tip_m = held("so101")
    with arm:
        goals = registers(arm, "goal_position")
        with pytest.raises(BadValueError, match="on one line"):
            arm.move_arc(tip_m + at(0.01, 0, 0), tip_m + at(0.02, 0, 0))
        with pytest.raises(BadValueError, match="radius"):
            arm.move_arc(center_m=tip_m)
        with pytest.raises(UnreachableError):
            arm.move_arc(tip_m + at(0.5, 0.0, 0.5), tip_m + at(1.0, 0, 0))
        assert registers(arm, "goal_position") == goals


def test_arc_through_table_is_refused():
    arm, tip_m = held("so101")
    with arm, pytest.raises(RefusedError, match="the table"):
        arm.plan_arc(center_m=tip_m - (0.0, 0.0, 0.04), normal=(1.0, 0.0, 0.0))


@pytest.mark.campaign
def test_arc_planned_for_limp_arm_is_replanned_after_sag():
    with ikservo.open_arm("so101", port="sim:?pose=home") as arm:
        plan = arm.plan_arc(center_m=arm.where().tip_m - (0.02, 0.0, 0.0))
        report = arm.execute(plan)
        assert report.reached
