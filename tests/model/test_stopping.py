"""The travel of a joint after its last goal, compared with its integrated equation of motion."""

import pytest

from ikservo.model import load_model
from ikservo.model.joint_drive import joint_drive, nominal_parameters
from ikservo.model.load_lag import spread_postures
from ikservo.model.travel_after_kill import stopping_times_s


def furthest(inertia, damping, stiffness):
    """Return the longest travel past its last goal of a joint at 1 rad/s, and its lag there."""
    at, speed, step_s, most = -damping / stiffness, 1.0, 1e-5, 0.0
    for _ in range(60_000):
        speed -= step_s * (damping * speed + stiffness * at) / inertia
        at += step_s * speed
        most = max(most, at)
    return damping / stiffness + most


@pytest.mark.parametrize(("name", "joint"), [
    ("wx250s", "waist"), ("so101", "elbow_flex"), ("vx300s", "forearm_roll"),
])  # fmt: skip
def test_stopping_time_includes_lag_and_swing_with_payload(name, joint):
    model = load_model(name)
    column = model.chain.names.index(joint)
    dynamics = nominal_parameters(model, model.chain).dynamics.with_payload(model.payload_kg)
    carried = dynamics.inertia_matrix(spread_postures(model.chain))[:, column, column].max()
    drive = joint_drive(model.joint(joint), model.supply_v)
    expected_s = furthest(
        carried + drive.armature_kg_m2, drive.damping_nm_s, drive.stiffness_nm_rad
    )
    found_s = stopping_times_s(model, model.chain)[joint]
    assert found_s == pytest.approx(1.15 * (expected_s + drive.delay_s), rel=0.005)


@pytest.mark.parametrize("name", ["koch", "px100"])
def test_gripper_stops_later_than_arm_joint_with_same_servo(name):
    model = load_model(name)
    joint = model.joint(model.gripper.joint)
    arm_drive = joint_drive(joint, model.supply_v)
    lag_s = arm_drive.delay_s + arm_drive.damping_nm_s / arm_drive.stiffness_nm_rad
    assert stopping_times_s(model, model.chain)[joint.name] > 1.15 * 1.5 * lag_s


def test_so101_gripper_stops_before_every_arm_joint():
    model = load_model("so101")
    times_s = stopping_times_s(model, model.chain)
    assert times_s["gripper"] < min(times_s[name] for name in model.chain.names)
