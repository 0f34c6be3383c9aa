"""Arrival under gravity and backlash, judged by the true positions of the joints."""

import contextlib
import math
from dataclasses import replace

import numpy as np
import pytest

import ikservo
from ikservo.arm import plan_execution
from ikservo.errors import IkservoError, NotSettledError, RefusedError
from ikservo.motion import JointMove
from ikservo.planning.motion_plan import rebase_trajectory
from ikservo.settling.tick_rounding import SettlingTarget
from tests.arm.simulated import (
    clock_of,
    line_of,
    motion_limits,
    registers,
    run_trajectory,
    servo_group,
    servo_id,
    true_joints,
)
from tests.oracle import tip_from_joints

PORT = "sim:?backlash_deg=0.5"
NAMES = ("so101", "open_manipulator_x")


def true_tip_m(arm):
    """Return the tip (3,) [m] of the true joints, without the rounding of ticks."""
    return tip_from_joints(
        arm.model.name, {joint.name: joint.position for joint in line_of(arm).world.joints}
    )


def plans(arm, count):
    """Yield plans to seeded random points, each from the present position of the arm."""
    rng = np.random.default_rng(11)
    while count:
        q = rng.uniform(arm.chain.lower_rad, arm.chain.upper_rad)
        try:
            plan = arm.plan_to(arm.chain.forward(q)[:3, 3], speed="fast")
        except IkservoError:
            continue
        yield plan
        count -= 1


def left_by_rounding_m(name, count):
    with ikservo.open_arm(name, port=PORT) as arm:
        for plan in plans(arm, count):
            limits, names = motion_limits(arm, plan.speed), servo_group(arm).names
            run_trajectory(
                arm,
                lambda goals, p=plan, m=limits, n=names: rebase_trajectory(p, goals, m, n),
                None,
                plan.speed,
            )
            clock = clock_of(arm)
            clock.sleep_until(clock.now_s() + 2.0)
            yield np.linalg.norm(true_tip_m(arm) - plan.target_m)


def left_by_us_m(name, count):
    with ikservo.open_arm(name, port=PORT) as arm:
        for plan in plans(arm, count):
            arm.execute(plan)
            yield np.linalg.norm(true_tip_m(arm) - plan.target_m)


@pytest.mark.full
def test_median_true_tip_error_is_at_most_half_a_millimetre():
    assert float(np.median(list(left_by_us_m("so101", 12)))) <= 0.5e-3


@pytest.mark.campaign
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("name", NAMES)
def test_tick_rounding_search_brings_true_tip_nearer_to_target(name):
    ours = float(np.median(list(left_by_us_m(name, 500))))
    assert ours <= 0.5e-3
    # Of 50 targets of so101: 0.40 and 0.57 mm, with uncoupled joints 0.36 and 0.71 mm.
    assert ours <= float(np.median(list(left_by_rounding_m(name, 500))))


# To the points of a square in front of a large arm: a tick of its waist is 0.7 mm there.
SQUARE = ((0.40, 0.10, 0.20), (0.40, -0.10, 0.20), (0.40, -0.10, 0.30), (0.40, 0.10, 0.30))


@pytest.mark.campaign
def test_wx250s_tip_settles_within_0_7_mm_of_square_corners():
    left_m = []
    for seed in (1, 2, 3, 4):
        with ikservo.open_arm("wx250s", port=f"{PORT}&pose=home&seed={seed}") as arm:
            arm.move_to(SQUARE[-1])
            for point_m in SQUARE:
                arm.move_line(point_m)
                left_m.append(np.linalg.norm(true_tip_m(arm) - point_m))
    assert np.median(left_m) < 0.7e-3


def test_settling_accepts_joints_within_two_ticks_of_goal(arm):
    plan = arm.plan_to((0.25, 0.05, 0.15))
    index, driven_joints = arm.context.index, servo_group(arm).driven_joints
    target = SettlingTarget(arm.chain, index, driven_joints, plan, plan.start)
    tick = driven_joints[0].joint_map.unit_per_tick
    near, far = plan.goal.copy(), plan.goal.copy()
    near[0] += 0.5 * tick
    near[4] += 2.0 * tick  # the wrist's roll hardly moves the tool
    far[0] += 2.5 * tick
    assert target.is_reached(plan.goal)
    assert target.is_reached(near)
    assert not target.is_reached(far)


def test_settling_rejects_tip_error_of_one_tick_on_all_joints(arm):
    plan = arm.plan_to((0.25, 0.05, 0.15))
    driven_joints = servo_group(arm).driven_joints
    target = SettlingTarget(arm.chain, arm.context.index, driven_joints, plan, plan.start)
    outward = np.sign(arm.chain.jacobian(plan.goal[: arm.chain.dof])[2])
    steps = np.append(outward, 0.0) * driven_joints[0].joint_map.unit_per_tick
    assert not target.is_reached(plan.goal + steps)


@pytest.fixture
def arm():
    with ikservo.open_arm("so101", port=f"{PORT}&pose=home") as machine:
        yield machine


@pytest.mark.full
def test_motion_report_separates_motion_and_settling_time(arm):
    plan = arm.plan_to((0.25, 0.05, 0.15))
    report = arm.execute(plan)
    before_s = 0.2  # in which rotors come to their flanks
    assert plan.duration_s <= report.motion_s <= 1.05 * plan.duration_s + before_s
    assert report.duration_s == pytest.approx(report.motion_s + report.settling_s)


@pytest.mark.full
def test_error_of_unsettled_motion_contains_motion_report(arm, monkeypatch):
    settle = plan_execution.settle
    loose = lambda *args: replace(settle(*args), unsettled=("shoulder_pan",))  # noqa: E731
    monkeypatch.setattr(plan_execution, "settle", loose)
    target_m = arm.where().tip_m + np.array([0.0, 0.0, 0.05])
    with pytest.raises(
        NotSettledError, match=r"shoulder_pan did .*; the tip is .* mm off its path"
    ) as line:
        arm.move_line(target_m)
    assert line.value.result.target_m == pytest.approx(target_m)
    assert line.value.result.path_error_max_m > 0.0
    with pytest.raises(NotSettledError, match=r"a joint is 0.* off") as joints:
        arm.move_joints({"shoulder_pan": 0.1})
    assert joints.value.result.measured_rad["shoulder_pan"] == pytest.approx(0.1, abs=0.01)


@pytest.mark.campaign
def test_joints_not_named_in_move_joints_stay_in_place(arm):
    arm.move_to((0.25, 0.05, 0.15), speed="fast")
    before = true_joints(arm)
    for angle in (0.2, 0.0):
        arm.move_joints({"shoulder_pan": angle}, speed="fast")
    for name in ("shoulder_lift", "elbow_flex", "wrist_flex"):
        assert true_joints(arm)[name] == pytest.approx(before[name], abs=math.radians(0.3))


@pytest.mark.full
def test_gripper_not_named_in_a_move_keeps_its_goal(arm):
    gripper = servo_id("so101", "gripper")
    arm.move_joints({"gripper": 0.5}, speed="fast")
    goal = registers(arm, "goal_position")[gripper]
    line_of(arm).servos[gripper].motor.stuck = True
    arm.move_to((0.25, 0.05, 0.15), speed="fast")
    assert registers(arm, "goal_position")[gripper] == goal


@pytest.mark.full
def test_motion_report_names_stuck_joint_with_bounded_lead(arm):
    arm.move_to((0.25, 0.05, 0.15), speed="fast")
    held = servo_id("so101", "wrist_flex")
    line_of(arm).servos[held].motor.stuck = True
    wrist = true_joints(arm)["wrist_flex"]
    inwards = wrist - math.radians(3.0)  # 7° of lead would end at a limit outwards
    report = arm.move_joints({"wrist_flex": inwards}, speed="fast")
    lead = registers(arm, "goal_position")[held] - registers(arm, "present_position")[held]
    assert abs(lead) <= servo_group(arm).driven_joints[held - 1].max_lead_ticks(0.0) + 1
    assert not report.reached
    assert report.binding == ("wrist_flex is 3.0° short: load too high (correction limit reached)",)


@pytest.mark.sample(4)
@pytest.mark.full
@pytest.mark.parametrize(
    ("name", "joint", "by_rad"),
    [
        ("koch", "elbow_flex", -0.6),
        ("omx_f", "joint2", 0.5),
        ("so100", "shoulder_lift", 0.6),
        ("open_manipulator_x", "joint2", 0.4),
        ("so101", "shoulder_lift", 0.6),
    ],
)
@pytest.mark.parametrize("short_rad", [0.05, 0.12])
def test_blocked_joint_does_not_cause_servo_overload_shutdown(name, joint, by_rad, short_rad):
    with ikservo.open_arm(name, port=f"{PORT}&pose=home&seed=1", collisions=False) as machine:
        machine.enable()
        servo, goal = servo_id(name, joint), machine.where().positions[joint] + by_rad
        motor = line_of(machine).servos[servo].motor

        def block(progress):
            motor.stuck |= abs(goal - progress.positions[joint]) <= short_rad

        with contextlib.suppress(RefusedError):  # where the guard names it
            assert not machine.move_joints({joint: goal}, speed="slow", on_progress=block).reached
        assert motor.stuck
        clock_of(machine).sleep_until(clock_of(machine).now_s() + 4.0)
        assert registers(machine, "torque_enable")[servo] == 1
        assert line_of(machine).servos[servo].alarm == 0


def ending_at(arm, plan, positions):
    """Return a plan to the same point with other joints."""
    names = arm.joint_names
    goal = np.array([positions.get(n, at) for n, at in zip(names, plan.start, strict=True)])
    limits = arm.context.planner.motion_limits(plan.speed)
    return replace(plan, goal=goal, trajectory=JointMove(plan.start, goal, limits))


@pytest.mark.full
def test_other_joints_compensate_sag_of_joint_at_its_limit(arm):
    home = dict(zip(arm.chain.names, arm.model.chain_pose("home"), strict=True))
    at_its_limit = home | {"elbow_flex": float(arm.chain.lower_rad[2]), "shoulder_lift": 0.6}
    target_m = arm.chain.forward([at_its_limit[name] for name in arm.chain.names])[:3, 3]
    arm.move_joints(at_its_limit, speed="fast")
    sagged_m = np.linalg.norm(true_tip_m(arm) - target_m)
    report = arm.execute(ending_at(arm, arm.plan_to(target_m), at_its_limit))
    assert sagged_m > 1e-3
    assert any("elbow_flex" in words and "at its limit" in words for words in report.binding)
    assert np.linalg.norm(true_tip_m(arm) - target_m) < 0.7e-3
