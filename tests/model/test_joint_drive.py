"""The drive of each joint: servos that share it add up, gears scale it."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

import ikservo
from ikservo.model.joint_drive import joint_drive, nominal_parameters
from ikservo.model.servo_torque import SERVO_TORQUES


def test_two_servos_on_joint_double_stiffness_and_friction():
    shoulder = ikservo.load_model("wx250s").joint("shoulder")
    both, alone = joint_drive(shoulder, None), joint_drive(replace(shoulder, shadows=()), None)
    assert both.stiffness_nm_rad == pytest.approx(2.0 * alone.stiffness_nm_rad)
    assert both.friction_torque(0.0, 3.0) == pytest.approx(2.0 * alone.friction_torque(0.0, 1.5))


def test_gear_multiplies_stiffness_by_square_of_ratio():
    pan = ikservo.load_model("so101").joint("shoulder_pan")
    direct, geared = (
        joint_drive(pan, None),
        joint_drive(replace(pan, travel_per_turn=math.pi), None),
    )
    assert geared.stiffness_nm_rad == pytest.approx(4.0 * direct.stiffness_nm_rad)
    assert geared.friction.coulomb_nm == pytest.approx(2.0 * direct.friction.coulomb_nm)


def test_gear_reduces_load_in_quadratic_friction():
    wrist = ikservo.load_model("koch").joint("wrist_roll")
    direct = joint_drive(wrist, None)
    geared = joint_drive(replace(wrist, travel_per_turn=math.pi), None)
    assert direct.friction.square_per_nm > 0.0
    assert geared.friction_torque(0.0, 0.4) == pytest.approx(2.0 * direct.friction_torque(0.0, 0.2))


@pytest.mark.parametrize("held_nm", [0.0, 0.3])
def test_static_load_equals_holding_torque_plus_friction(held_nm):
    drive = joint_drive(ikservo.load_model("koch").joint("wrist_roll"), None)
    load_nm = drive.friction.static_load_nm(held_nm)
    assert load_nm == pytest.approx(held_nm + drive.friction_torque(0.0, load_nm))


def test_joint_with_unknown_servo_model_has_no_drive_model():
    pan = ikservo.load_model("so101").joint("shoulder_pan")
    assert joint_drive(replace(pan, servo=replace(pan.servo, model="HX-7")), None) is None


def test_joint_friction_falls_with_speed_and_rises_with_load():
    drive = joint_drive(ikservo.load_model("so101").joint("elbow_flex"), None)
    gears = SERVO_TORQUES["STS3215", None].friction
    assert drive.friction_torque(0.0, 0.0) == pytest.approx(gears.coulomb_nm + gears.slow_nm)
    assert drive.friction_torque(50.0, -2.0) == pytest.approx(gears.coulomb_nm + 2.0 * gears.load)
    assert drive.friction_torque(0.1, 1.0) > drive.friction_torque(0.1, 0.0)


def test_every_joint_of_shipped_arms_has_a_drive_model():
    for name in ("so101", "koch", "open_manipulator_x", "px100", "wx250s", "vx300s"):
        model = ikservo.load_model(name)
        assert None not in nominal_parameters(model, model.chain).drives


def test_arm_without_masses_has_no_nominal_dynamic_parameters():
    model = ikservo.load_model("so101")
    weightless = tuple(replace(link, mass_kg=0.0) for link in model.urdf.links)
    model = replace(model, urdf=replace(model.urdf, links=weightless))
    assert nominal_parameters(model, model.chain) is None
