"""Moves to a point, judged by the simulated servos' own registers."""

import math

import numpy as np
import pytest

import ikservo
from ikservo.errors import (
    BadValueError,
    RefusedError,
    UnknownNameError,
    UnreachableError,
)
from tests.arm.audit import Auditor
from tests.arm.random_faults import seeded
from tests.arm.simulated import line_of, registers, servo_group, servo_id, true_joints, true_tip_m
from tests.oracle import ARMS

pytestmark = pytest.mark.smoke

NEAR = (0.23, 0.02, 0.10)  # home: the first motion is slow


@pytest.fixture
def arm():
    with ikservo.open_arm("so101", port="sim:?pose=home") as machine:
        yield machine


@pytest.mark.sample(3)
@pytest.mark.parametrize("name", ARMS)
def test_every_arm_reaches_its_target_within_2_mm(name):
    model = ikservo.load_model(name)
    target = model.chain.forward(0.7 * model.chain_pose("home") + 0.05)[:3, 3]
    with ikservo.open_arm(model, port="sim:?pose=home") as arm:
        report = arm.move_to(target)
        np.testing.assert_allclose(true_tip_m(arm), target, atol=2e-3)
    assert report.reached


def test_move_report_equals_values_of_servo_registers(arm):
    report = arm.move_to(NEAR)
    np.testing.assert_allclose(report.measured_tip_m, true_tip_m(arm), atol=1e-9)
    assert report.error_m == pytest.approx(float(np.linalg.norm(true_tip_m(arm) - np.array(NEAR))))


def test_opening_an_arm_moves_nothing_and_leaves_torque_off(arm):
    before = registers(arm, "goal_position")
    arm.where()
    assert registers(arm, "goal_position") == before
    assert not any(registers(arm, "torque_enable").values())


def test_torque_on_keeps_joints_within_2_ticks(arm):
    auditor = Auditor(arm)
    arm.enable()
    assert all(registers(arm, "torque_enable").values())
    assert all(abs(goal.tick - goal.present) <= 2 for goal in auditor.goals)


@pytest.mark.full
def test_enabling_an_arm_that_holds_keeps_its_goals(arm):
    arm.move_to(NEAR)
    goals = registers(arm, "goal_position")
    arm.enable()
    assert registers(arm, "goal_position") == goals


@pytest.mark.full
def test_second_move_starts_where_first_one_ended(arm):
    arm.move_to(NEAR)
    report = arm.move_to((0.22, -0.02, 0.12), speed="fast")
    assert report.reached
    np.testing.assert_allclose(true_tip_m(arm), (0.22, -0.02, 0.12), atol=2e-3)


@pytest.mark.full
def test_move_to_present_point_succeeds(arm):
    here = arm.move_to(NEAR).measured_tip_m
    assert arm.move_to(here).reached


def test_slow_speed_takes_twice_as_long_as_fast(arm):
    arm.move_joints(arm.model.pose("home"))  # the first motion is slow, whatever is asked
    slow = arm.plan_to((0.25, 0.05, 0.15), speed="slow").duration_s
    assert slow > 2 * arm.plan_to((0.25, 0.05, 0.15), speed="fast").duration_s


@pytest.mark.full
def test_unreachable_point_error_suggests_nearest_point():
    with ikservo.open_arm("so101", port="sim:?pose=zero") as arm:  # stretched, as it will be there
        before = registers(arm, "goal_position")
        with pytest.raises(UnreachableError, match="Nearest reachable point") as caught:
            arm.move_to((0.9, 0.0, 0.1))
        assert registers(arm, "goal_position") == before
        assert arm.move_to(0.99 * np.array(caught.value.nearest_m)).reached


@pytest.mark.parametrize("point", [(0.25, 0.05), (math.nan, 0, 0.1), (0, math.inf, 0), "here"])
def test_invalid_point_moves_nothing(arm, point):
    with pytest.raises(BadValueError):
        arm.move_to(point)
    assert not any(registers(arm, "torque_enable").values())


def test_unknown_speed_name_moves_nothing(arm):
    with pytest.raises(UnknownNameError, match="fast"):
        arm.move_to((0.25, 0.05, 0.15), speed="fsat")
    assert not any(registers(arm, "torque_enable").values())


def test_move_reports_progress_until_its_end(arm):
    seen = []
    arm.move_to(NEAR, on_progress=seen.append)
    assert [p.elapsed_s for p in seen] == sorted(p.elapsed_s for p in seen)
    assert seen[-1].elapsed_s == seen[-1].duration_s
    assert len(seen) > 50


def test_keyboard_interrupt_leaves_the_arm_holding(arm):
    def interrupt(progress):
        if progress.elapsed_s > 0.5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt, match="torque stays on"):
        arm.move_to((0.25, 0.05, 0.15), on_progress=interrupt)
    assert all(registers(arm, "torque_enable").values())
    apart = np.linalg.norm(true_tip_m(arm) - (0.25, 0.05, 0.15))
    assert apart > 0.02


def test_error_names_jammed_joint_and_motion_stops(arm):
    pan = line_of(arm).servos[servo_id("so101", "shoulder_pan")]

    def jam(progress):
        if progress.elapsed_s > 0.3:
            pan.motor.stuck = True

    with pytest.raises(RefusedError, match="shoulder_pan does not follow"):
        arm.move_joints({"shoulder_pan": 1.5}, on_progress=jam)
    goals = registers(arm, "goal_position")
    assert abs(goals[1] - registers(arm, "present_position")[1]) < 300


def test_move_through_table_is_refused_before_motion(arm):
    before = registers(arm, "goal_position")
    with pytest.raises(RefusedError, match="would touch the table"):
        arm.move_to((0.25, 0.0, -0.08))
    assert registers(arm, "goal_position") == before


@pytest.mark.full
def test_collision_check_can_be_switched_off():
    with ikservo.open_arm("so101", port="sim:?pose=home", collisions=False) as arm:
        assert arm.move_to((0.25, 0.0, -0.05)).reached


def test_move_joints_reaches_positions_gripper_included(arm):
    report = arm.move_joints({"elbow_flex": 0.5, "gripper": 0.8})
    joints = true_joints(arm)
    assert report.reached
    assert joints["elbow_flex"] == pytest.approx(0.5, abs=math.radians(0.5))
    assert joints["gripper"] == pytest.approx(0.8, abs=math.radians(0.5))


@pytest.mark.parametrize("position", [1.7, -1.7, 100.0])
def test_move_joints_refuses_position_beyond_limit(arm, position):
    before = registers(arm, "goal_position")
    with pytest.raises(RefusedError, match=r"elbow_flex .* limit .*96\.8° \(arm file\)"):
        arm.move_joints({"elbow_flex": position, "wrist_flex": 0.1})
    assert registers(arm, "goal_position") == before


@pytest.mark.parametrize("name", ARMS)
def test_motion_to_zero_and_rest_pose_can_be_planned(name):
    model = ikservo.load_model(name)
    with ikservo.open_arm(model, port="sim:?pose=home") as arm:
        for pose in ("zero", "rest"):
            assert arm.plan_joints(model.pose(pose)).duration_s > 0.0, pose


FEW = ("so101", "open_manipulator_x", "wx250s")  # both families, a slide, shadows
ALL = [name if name in FEW else pytest.param(name, marks=pytest.mark.campaign) for name in ARMS]


@pytest.mark.full
@pytest.mark.sample(1)
@pytest.mark.parametrize("name", ALL)
def test_every_arm_reaches_its_home_zero_and_rest_pose(name):
    model = ikservo.load_model(name)
    with ikservo.open_arm(model, port="sim:?pose=home") as arm:  # the first motion is slow
        for pose in ("home", "zero", "rest"):
            assert arm.move_joints(model.pose(pose), speed="fast").reached, pose


@pytest.mark.full
def test_relax_lowers_arm_to_rest_pose_before_torque_off(arm):
    arm.move_to(NEAR)
    report = arm.relax()
    assert report.reached
    assert not any(registers(arm, "torque_enable").values())
    rest = {j: v for j, v in arm.model.pose("rest").items() if j in arm.chain.names}
    np.testing.assert_allclose([true_joints(arm)[j] for j in rest], list(rest.values()), atol=0.03)


def test_relax_plans_around_obstacles_via_home_pose():
    folded = {"waist": -1.3, "shoulder": -0.33, "elbow": 1.49, "forearm_roll": -2.69,
              "wrist_angle": 1.3, "wrist_rotate": -0.15}  # fmt: skip
    with ikservo.open_arm("wx250s", port="sim") as arm:
        for joint, position in folded.items():
            line_of(arm).world.place(joint, position)
        with pytest.raises(RefusedError, match="would touch"):
            arm.plan_joints(arm.model.pose("rest"), straight=True)
        assert arm.plan_rest().via_pose == "home"


@pytest.mark.sample(1)
@pytest.mark.parametrize("name", ["koch", "px100"])
def test_arm_that_sags_at_torque_on_still_completes_motion(name):
    dice = seeded(1)
    with ikservo.open_arm(name, port="sim", collisions=False) as arm:
        for driven in servo_group(arm).driven_joints:
            line_of(arm).world.place(driven.joint, dice.uniform(*driven.position_range))
        arm.plan_joints({arm.chain.names[0]: 0.0})
        assert arm.move_joints({arm.chain.names[0]: 0.0}).reached


@pytest.mark.parametrize(("on_exit", "torque"), [("hold", True), ("relax", False)])
def test_on_exit_selects_whether_closing_holds_or_relaxes(on_exit, torque):
    with ikservo.open_arm("so101", port="sim", on_exit=on_exit) as arm:
        arm.enable()
    assert set(map(bool, registers(arm, "torque_enable").values())) == {torque}


def test_error_in_with_block_leaves_torque_on():
    def stumble(_):
        raise ZeroDivisionError

    arm = ikservo.open_arm("so101", port="sim", on_exit="relax")
    with pytest.raises(ZeroDivisionError), arm:
        arm.move_to((0.25, 0.05, 0.15), on_progress=stumble)
    assert all(registers(arm, "torque_enable").values())


def test_unknown_on_exit_value_is_refused():
    with pytest.raises(UnknownNameError, match="hold, relax"):
        ikservo.open_arm("so101", port="sim", on_exit="drop")


@pytest.mark.full
def test_prismatic_gripper_moves_in_metres():
    with ikservo.open_arm("open_manipulator_x", port="sim") as arm:
        assert arm.move_joints({"gripper": 0.01}).reached
        assert true_joints(arm)["gripper"] == pytest.approx(0.01, abs=2e-4)
