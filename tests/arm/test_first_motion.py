"""The first motion of a limp arm, from its rest pose or while it falls, and the way back."""

import math
from dataclasses import replace

import numpy as np
import pytest

import ikservo
from ikservo.calibration import Limits
from ikservo.errors import RefusedError
from tests.arm.simulated import (
    clock_of,
    line_of,
    registers,
    true_joints,
    true_tip_m,
)
from tests.oracle import ARMS, arm_file

# Its end stops are 2° behind its limits; a forearm that falls on the table shakes the wrist, whose
# gears have play.
STAYS_RAD = math.radians(7.5)

# Arms that fell past a limit before their first motion, and a slide; tests/journeys has all.
FEW = ("koch", "wx250s", "open_manipulator_x")
ALL = [name if name in FEW else pytest.param(name, marks=pytest.mark.campaign) for name in ARMS]


def home_tip_m(model):
    return model.chain.forward(model.chain_pose("home"))[:3, 3]


def pass_time(arm, seconds):
    clock = clock_of(arm)
    clock.sleep_until(clock.now_s() + seconds)


def limp(arm):
    return not any(registers(arm, "torque_enable").values())


def narrowed(name, **ranges_deg):
    """Return an arm whose user has narrowed its limits."""
    model = ikservo.load_model(name)
    joints = [
        replace(joint, limits=Limits.of(joint.name, *np.radians(ranges_deg[joint.name]), "user"))
        if joint.name in ranges_deg
        else joint
        for joint in model.joints
    ]
    return replace(model, joints=tuple(joints))


@pytest.mark.sample(6)
@pytest.mark.full
@pytest.mark.parametrize("name", ARMS)
def test_a_limp_arm_stays_in_its_rest_pose(name):
    with ikservo.open_arm(name, port="sim") as arm:
        pass_time(arm, 5.0)
        found, rest = true_joints(arm), arm.model.pose("rest")
        assert {j: found[j] for j in rest} == pytest.approx(dict(rest), abs=STAYS_RAD)


@pytest.mark.campaign
@pytest.mark.parametrize("name", ARMS)
def test_limp_arm_stays_in_rest_pose_with_mujoco_contacts(name):
    pytest.importorskip("mujoco")
    with ikservo.open_arm(name, port="sim:?physics=1") as arm:
        pass_time(arm, 5.0)
        found, rest = true_joints(arm), arm.model.pose("rest")
        assert {j: found[j] for j in rest} == pytest.approx(dict(rest), abs=math.radians(6.5))


@pytest.mark.sample(1)
@pytest.mark.parametrize("name", ALL)
def test_first_motion_from_rest_pose_reaches_its_target(name):
    with ikservo.open_arm(name, port="sim") as arm:
        target_m = home_tip_m(arm.model)
        assert arm.move_to(target_m).reached
        np.testing.assert_allclose(true_tip_m(arm), target_m, atol=2e-3)


@pytest.mark.sample(1)
@pytest.mark.parametrize("name", ["koch", "wx250s"])
def test_plan_for_limp_arm_is_recomputed_after_it_sagged(name):
    with ikservo.open_arm(name, port="sim:?pose=home") as arm:
        plan = arm.plan_to(home_tip_m(arm.model) + np.array([0.0, 0.0, 0.02]))
        pass_time(arm, 0.3)  # nobody holds it, and a person reads what it would do
        report = arm.execute(plan)
        assert report.reached
        np.testing.assert_allclose(true_tip_m(arm), plan.target_m, atol=2e-3)


@pytest.mark.full
def test_plan_starts_where_arm_was_moved_by_hand():
    with ikservo.open_arm("so101", port="sim") as arm:
        plan = arm.plan_to(home_tip_m(arm.model))
        line_of(arm).world.place("shoulder_pan", 1.0)
        assert arm.execute(plan).reached
        np.testing.assert_allclose(true_tip_m(arm), plan.target_m, atol=2e-3)


@pytest.mark.full
@pytest.mark.sample(1)
@pytest.mark.parametrize(("name", "joint"), [("koch", "elbow_flex"), ("wx250s", "shoulder")])
def test_joint_on_its_end_stop_is_moved_back_inside_limits(name, joint):
    with ikservo.open_arm(name, port="sim", collisions=False) as arm:
        line_of(arm).world.place(joint, -3.0)  # further than it goes
        assert arm.pose("home").reached


def lay_down(arm, **degrees):
    """Lay a limp arm down, as a hand would, and let it come to rest."""
    for joint, angle in degrees.items():
        line_of(arm).world.place(joint, math.radians(angle))
    pass_time(arm, 5.0)


@pytest.mark.full
def test_error_tells_that_servo_is_too_weak_for_posture():
    with ikservo.open_arm("omx_l", port="sim") as arm:
        lay_down(arm, joint2=96.0, joint3=-80.0, joint4=-18.0)
        with pytest.raises(RefusedError, match=r"joint2 does not follow.*too weak to lift"):
            arm.pose("home")


LIFTED = {"shoulder_lift": (-95.0, 95.0), "elbow_flex": (-90.0, 90.0)}


@pytest.mark.full
@pytest.mark.sample(1)
@pytest.mark.parametrize("start", ["rest", "home"])
def test_rest_pose_outside_limits_does_not_prevent_relax(start):
    with ikservo.open_arm(
        narrowed("so101", **LIFTED), port=f"sim:{arm_path()}?pose={start}"
    ) as arm:
        arm.pose("home")
        report = arm.relax()
        assert report.reached
        assert limp(arm)
        assert any(words.startswith("shoulder_lift goes to -9") for words in report.binding)


@pytest.mark.campaign
def test_rest_pose_outside_limits_is_approached_up_to_limit():
    with ikservo.open_arm(narrowed("so101", **LIFTED), port=f"sim:{arm_path()}") as arm:
        arm.pose("home")
        assert arm.pose("rest").reached
        # its goal may not pass the limit: the target is as far inside as friction may keep it
        # short, 0.070 N m on 17.5 N m/rad
        friction_rad = 0.070 / 17.5
        assert true_joints(arm)["elbow_flex"] == pytest.approx(
            math.radians(90.0) - friction_rad, abs=0.003
        )


def test_pose_far_outside_limits_is_refused_before_motion():
    with ikservo.open_arm(
        narrowed("so101", wrist_flex=(-90.0, 40.0)), port=f"sim:{arm_path()}"
    ) as arm:
        with pytest.raises(RefusedError, match="wrist_flex target"):
            arm.pose("home")
        assert limp(arm)


@pytest.mark.full
def test_arm_that_cannot_be_lowered_goes_limp_and_reports_why():
    with ikservo.open_arm("so101", port="sim:?pose=home") as arm:
        arm.pose("home")
        line_of(arm).servos[2].motor.stuck = True
        report = arm.relax()
        assert limp(arm)
        assert not report.reached
        assert "shoulder_lift does not follow" in report.binding[0]


@pytest.mark.full
def test_stopped_arm_does_not_relax_before_acknowledgement():
    with ikservo.open_arm("so101", port="sim:?pose=home") as arm:
        arm.pose("home")
        arm.stop("Stopped by somebody.")
        with pytest.raises(RefusedError, match="Stopped by somebody"):
            arm.relax()
        assert not limp(arm)
        arm.acknowledge()
        assert arm.relax().reached


def arm_path():
    return ikservo.load_model("so101").path


def test_every_arm_file_has_a_rest_pose():
    assert all("rest" in arm_file(name)["poses"] for name in ARMS)
