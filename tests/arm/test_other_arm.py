"""Two arms on one table: each keeps clear of the other, and one moves at a time."""

import math
import shutil
import threading
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import ikservo
from ikservo.errors import BadValueError, CollisionError, RefusedError, UnknownNameError
from ikservo.kinematics.capsules import segment_distance
from ikservo.kinematics.se3 import make_pose, rotation_rpy
from tests.arm.seeds import few_or_many, log
from tests.arm.simulated import context_of, line_of, motion_runner, servo_group
from tests.arm.test_faults_in_motion import inject

BESIDE_M, FACING_DEG = (0.45, 0.0, 0.0), (0.0, 0.0, 180.0)
LEFT, RIGHT, ASIDE = (0.2, 0.15, 0.12), (0.24, -0.12, 0.12), (0.0, 0.15, 0.15)


@pytest.fixture
def arms():
    """Return so101 and, opposite, koch with its gripper on the straight path LEFT to RIGHT."""
    with (
        ikservo.open_arm("so101", port="sim:?pose=home") as arm,
        ikservo.open_arm("koch", port="sim:?pose=home") as other,
    ):
        arm.move_to(LEFT)
        other.move_to((0.22, 0.0, 0.12))
        arm.scene.add_arm(other, "the koch", at_m=BESIDE_M, rpy_deg=FACING_DEG)
        yield arm, other


def true_joints(arm):
    return np.array([line_of(arm).world.joint(name).position for name in servo_group(arm).names])


def placed(arm, joints, T):
    """Return starts, ends (n, 3) and radii (n,) of the links at joints (n,), moved by T (4, 4)."""
    capsules = context_of(arm).collision.capsules_at(arm.joint_index.body_joints(joints))
    ends = np.array([(each.start_m, each.end_m) for each in capsules])
    ends = ends @ T[:3, :3].T + T[:3, 3]
    return ends[:, 0], ends[:, 1], np.array([each.radius_m for each in capsules])


def true_distance_m(arm, other, T):
    """Return the distance of two arms, the base of the other one at T (4, 4)."""
    return distance_m(
        placed(arm, true_joints(arm), np.eye(4)), placed(other, true_joints(other), T)
    )


def distance_m(one, another):
    (a, b, r), (c, d, s) = one, another
    i, j = np.indices((len(r), len(s))).reshape(2, -1)
    return float((segment_distance(a[i], b[i], c[j], d[j]) - r[i] - s[j]).min())


def test_collision_error_names_second_arm_in_path(arms):
    arm, other = arms
    assert (arm.scene.names, other.scene.names) == (("the koch",), ("so101",))
    with pytest.raises(CollisionError, match="would touch the koch's gripper"):
        arm.move_to(RIGHT, straight=True)
    other.move_to(ASIDE)
    assert arm.move_to(RIGHT, straight=True).reached
    with pytest.raises(CollisionError, match="would touch so101's"):
        other.move_to((0.22, 0.1, 0.1), straight=True)
    arm.scene.remove("the koch")
    assert (arm.scene.names, other.scene.names) == ((), ())


@pytest.mark.full
def test_plan_avoids_second_arm(arms):
    arm, other = arms
    T = make_pose(BESIDE_M, rotation_rpy(0.0, 0.0, math.pi))
    plan, nearest_m = arm.plan_to(RIGHT), []
    assert "the koch's gripper" in plan.around

    def watch(_):
        nearest_m.append(true_distance_m(arm, other, T))

    assert arm.execute(plan, on_progress=watch).reached
    assert min(nearest_m) > 0.01


@pytest.mark.full
def test_plan_is_refused_if_second_arm_moved_into_path(arms):
    arm, other = arms
    other.move_to(ASIDE)
    plan = arm.plan_to(RIGHT, straight=True)
    other.move_to((0.22, 0.0, 0.12))
    with pytest.raises(CollisionError, match="the koch"):
        arm.execute(plan)


def test_only_one_of_two_arms_moves_at_a_time(arms):
    arm, other = arms
    refused = []

    def move_the_other(_):
        for command in (lambda: other.move_to((0.15, 0.0, 0.12)), lambda: other.gripper("open")):
            with pytest.raises(RefusedError, match=r"so101, which is in reach, is moving\."):
                command()
        with pytest.raises(RefusedError, match="is moving"):
            other.plan_to((0.15, 0.0, 0.12))
        refused.append(other.where().tip_m)

    arm.move_to((0.18, 0.17, 0.1), on_progress=move_the_other)
    assert len(refused) > 10
    assert np.ptp(refused, axis=0).max() < 1e-3
    assert other.move_to((0.15, 0.0, 0.12)).reached


@pytest.mark.full
def test_motion_is_refused_while_other_thread_moves_second_arm(arms):
    arm, other = arms
    begun, go_on, reports = threading.Event(), threading.Event(), []

    def hold_up(_):
        begun.set()
        go_on.wait(10.0)

    def move():
        reports.append(arm.move_to((*LEFT[:2], 0.1), on_progress=hold_up))

    mover = threading.Thread(target=move)
    mover.start()
    begun.wait(10.0)
    with pytest.raises(RefusedError, match="is moving"):
        other.move_to((0.15, 0.0, 0.12))
    go_on.set()
    mover.join()
    assert [report.reached for report in reports] == [True]


def things_around(arm):
    checker = context_of(arm).collision
    return dict(zip(checker.things, checker.shapes, strict=True))


@pytest.mark.full
def test_limp_second_arm_is_avoided_where_it_was_moved_to(arms):
    arm, other = arms
    other.disable_torque()
    pan = other.joint_names[0]
    line_of(other).world.place(pan, 0.9)
    arm.move_to((0.21, 0.12, 0.12), straight=True)
    before = things_around(arm)
    line_of(other).world.place(pan, -0.9)
    arm.move_to(LEFT, straight=True)
    now = things_around(arm)
    moved = {name for name in now if not np.allclose(now[name], before[name], atol=0.02)}
    assert "the koch's gripper" in moved
    assert "the koch's base_link" not in moved


@pytest.mark.campaign
def test_closed_second_arm_stays_an_obstacle(arms):
    arm, other = arms
    other.close()
    with pytest.raises(CollisionError, match="would touch the koch's gripper"):
        arm.move_to(RIGHT, straight=True)
    arm.relax()
    arm.scene.remove("the koch")
    assert arm.move_to(RIGHT, straight=True).reached


def test_reopened_arm_keeps_its_placement_in_scene(arms):
    arm, other = arms
    before = other.scene
    other.close()
    with ikservo.open_arm("koch", port="sim:?pose=rest") as again:
        again.scene.take_over(before)
        assert (arm.scene.names, again.scene.names) == (("the koch",), ("so101",))
        assert before.names == ()
        assert arm.move_to(RIGHT, straight=True).reached  # it is at rest now
        begun, seen = threading.Event(), threading.Event()

        def hold_up(_):
            begun.set()
            seen.wait(20.0)

        arm.move_to(LEFT, straight=True, on_progress=hold_up, wait=False)
        begun.wait(10.0)
        with pytest.raises(RefusedError, match=r"so101, which is in reach, is moving\."):
            again.move_to((0.15, 0.0, 0.12))
        for change in (
            lambda: again.scene.change("so101", at_m=(0.4, 0.0, 0.0)),
            lambda: arm.scene.remove("the koch"),
        ):
            with pytest.raises(RefusedError, match="is moving"):
                change()
        seen.set()
        arm.stop()


def test_placement_of_second_arm_changes_in_both_scenes(arms):
    arm, other = arms
    with pytest.raises(CollisionError, match="would touch the koch's gripper"):
        arm.move_to(RIGHT, straight=True)
    other.scene.change("so101", at_m=(0.0, 0.9, 0.0), rpy_deg=(0.0, 0.0, 90.0))
    (there,), (here,) = arm.scene.arms, other.scene.arms
    np.testing.assert_allclose(there.T_base_other @ here.T_base_other, np.eye(4), atol=1e-12)
    assert there.placed.at_m == pytest.approx((-0.9, 0.0, 0.0))
    assert there.placed.rpy_deg == pytest.approx((0.0, 0.0, -90.0))
    assert arm.move_to(RIGHT, straight=True).reached
    for wrong in ({"at_m": (0.0, 0.0, 0.0)}, {"radius_m": 1.0}):
        with pytest.raises((BadValueError, UnknownNameError)):
            arm.scene.change("the koch", **wrong)
    assert arm.scene.arms == (there,)


def test_scene_file_with_arm_that_is_not_open_is_refused(arms, tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text('[[arm]]\nname = "third"\nat_m = [0, 0.5, 0]\n')
    with pytest.raises(RefusedError, match="third, which is not open in this program"):
        arms[0].scene.load(path)
    assert arms[0].scene.names == ("the koch",)


@pytest.mark.campaign
def test_motion_is_refused_if_second_arm_is_unmeasurable(arms):
    arm, other = arms
    inject(other, "unplug", after_s=0.0)
    with suppress(ikservo.PortLostError):
        other.where()
    before = dict(arm.where().positions)
    for command in (arm.plan_to, arm.move_to):
        with pytest.raises(RefusedError, match="Where the koch is, which this arm can reach"):
            command((0.2, 0.1, 0.12))
    assert arm.where().positions == pytest.approx(before, abs=0.01)
    arm.scene.remove("the koch")
    assert arm.move_to((0.2, 0.1, 0.12)).reached


@pytest.mark.full
def test_stop_of_either_of_two_arms_is_never_refused(arms):
    arm, other = arms

    def stop(_):
        other.stop()
        arm.stop()

    with pytest.raises(ikservo.StoppedError):
        arm.move_to((0.18, 0.17, 0.1), on_progress=stop)
    assert other.stop_reason is not None


@pytest.mark.full
def test_add_arm_refuses_invalid_arms_places_and_names(arms):
    arm, other = arms
    for wrong in (arm, other, None, object()):
        with pytest.raises(BadValueError, match="another arm of this program"):
            arm.scene.add_arm(wrong, "x", at_m=BESIDE_M)
    with ikservo.open_arm("so100", port="sim:?pose=home") as third:
        nowhere = ((math.nan, 0.0, 0.0), (1e9, 0.0, 0.0), (0.0, 0.4), "there", (0.0, 0.0, 0.01))
        for place in nowhere:
            with pytest.raises(BadValueError):
                arm.scene.add_arm(third, "third", at_m=place)
        with pytest.raises(BadValueError, match="unused name"):
            arm.scene.add_arm(third, "the koch", at_m=(0.0, 0.5, 0.0))
        assert third.scene.names == ()
        arm.scene.add_arm(third, "third", at_m=(0.0, 0.5, 0.0))
        assert arm.scene.names == ("the koch", "third")
    with pytest.raises(UnknownNameError, match="third"):
        arm.scene.remove("the third")
    with ikservo.open_arm("so101", port="sim:?pose=home", collisions=False) as unchecked:
        with pytest.raises(RefusedError, match="without collision checks"):
            arm.scene.add_arm(unchecked, "unchecked", at_m=(0.0, -0.5, 0.0))
        assert unchecked.scene.names == ()
    assert motion_runner(arm).stop_reason is None


def near_goal(arm, others_links, random):
    """Draw the posture nearest to the other arm among several, and yet 30 mm away."""
    lower, upper = arm.limits()
    goals = random.uniform(lower, upper, (30, len(lower)))
    away_m = np.array([distance_m(placed(arm, q, np.eye(4)), others_links) for q in goals])
    goal = goals[np.where(away_m > 0.03, away_m, np.inf).argmin()]
    return dict(zip(arm.chain.names, arm.joint_index.chain_joints(goal).tolist(), strict=True))


@pytest.mark.campaign
@few_or_many(1, 25)
@pytest.mark.parametrize("names", [("so101", "koch"), ("open_manipulator_x", "so101")])
def test_two_arms_moving_in_turn_never_touch(capsys, names, seeds):
    """Each goes to random postures in turn; true links are compared in each cycle of both."""
    nearest_m, moved, refused = [], 0, 0
    for seed in seeds:
        random = np.random.default_rng(seed)
        turned_rad, away_m = random.uniform(-math.pi, math.pi), random.uniform(0.2, 0.4)
        at_m = (away_m * math.cos(turned_rad), away_m * math.sin(turned_rad), 0.0)
        yaw_rad = random.uniform(-math.pi, math.pi)
        T = make_pose(at_m, rotation_rpy(0.0, 0.0, yaw_rad))
        with (
            ikservo.open_arm(names[0], port=f"sim:?pose=home&seed={seed}") as one,
            ikservo.open_arm(names[1], port=f"sim:?pose=home&seed={seed}") as two,
        ):
            if true_distance_m(one, two, T) < 0.03:
                continue
            one.scene.add_arm(two, "two", at_m=at_m, rpy_deg=(0.0, 0.0, math.degrees(yaw_rad)))

            def watch(_, one=one, two=two, T=T):
                nearest_m.append(true_distance_m(one, two, T))

            for turn in range(6):
                arm, other = (one, two) if turn % 2 else (two, one)
                T_here = T if arm is one else np.linalg.inv(T)
                goals = near_goal(arm, placed(other, true_joints(other), T_here), random)
                try:
                    arm.move_joints(goals, on_progress=watch)
                    moved += 1
                except RefusedError:
                    refused += 1
    log(
        capsys,
        f"{names}: {moved} motions, {refused} refused, nearest {1000 * min(nearest_m):.1f} mm",
    )
    assert moved
    assert min(nearest_m) > 0.0


def test_scenes_are_of_same_arm_only_with_same_adapter():
    with ikservo.open_arm("koch", port="sim") as one, ikservo.open_arm("koch", port="sim") as other:
        assert one.scene.is_of_same_arm(other.scene)
        other.scene._context = replace(other.context, serial_number="58FA083")
        assert not one.scene.is_of_same_arm(other.scene)


def test_placed_arm_is_saved_by_arm_file_or_catalogue_name(arms, tmp_path):
    arm, other = arms
    assert arm.scene.arms[0].placed.arm == "koch"
    shutil.copytree(other.model.path.parent, tmp_path / "mine")
    with ikservo.open_arm(tmp_path / "mine", port="sim:?pose=home") as own:
        arm.scene.add_arm(own, "mine", at_m=(-0.45, 0.0, 0.0))
        placed = {each.name: each.placed for each in arm.scene.arms}
        assert Path(placed["mine"].arm) == own.model.path
        arm.scene.remove("mine")
