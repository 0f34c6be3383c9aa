"""Feed-forward: goals lead a reference by the expected lag of the servos."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import ikservo
from ikservo.control.feed_forward import FeedForward
from ikservo.model.joint_drive import nominal_parameters
from ikservo.motion import TrajectoryPoint

LIFT = 1


@pytest.fixture(scope="module")
def parameters():
    model = ikservo.load_model("so101")
    return nominal_parameters(model, model.chain)


@pytest.fixture
def feed_forward(parameters):
    return FeedForward(parameters, range(5))


def moving(velocity=0.0, acceleration=0.0, posture=(0.0, 0.3, 0.2, 0.1, 0.0)):
    one = np.eye(5)[LIFT]
    return TrajectoryPoint(np.array(posture), velocity * one, acceleration * one)


def offsets(feed_forward, point, direction=0.0, **options):
    return feed_forward.offsets(point, np.full(5, direction), **options)


def test_feed_forward_at_rest_is_weight_over_stiffness(feed_forward, parameters):
    weight_nm = parameters.dynamics.gravity_torques(moving().position)[LIFT]
    drive = parameters.drives[LIFT]
    expected = (weight_nm - np.sign(weight_nm) * drive.startup_nm) / drive.stiffness_nm_rad
    assert offsets(feed_forward, moving())[LIFT] == pytest.approx(expected)


def test_feed_forward_of_unloaded_joint_is_zero(feed_forward):
    assert offsets(feed_forward, moving())[0] == pytest.approx(0.0, abs=1e-12)


def test_feed_forward_adds_lag_of_back_emf_and_delay(feed_forward, parameters):
    drive, still, fast = parameters.drives[0], moving(), moving()
    fast = replace(fast, velocity=np.eye(5)[0])
    turned = offsets(feed_forward, fast)[0] - offsets(feed_forward, still)[0]
    lag = (drive.damping_nm_s - drive.startup_nm) / drive.stiffness_nm_rad
    assert turned == pytest.approx(lag + drive.delay_s, rel=0.01)


def test_feed_forward_adds_half_of_goal_hold_time(feed_forward):
    briefly, long = (
        offsets(feed_forward, moving(velocity=1.0), held_s=held_s)[LIFT] for held_s in (0.0, 0.01)
    )
    assert long - briefly == pytest.approx(0.005)


def test_feed_forward_leads_by_friction_along_the_motion(feed_forward, parameters):
    up, down = (offsets(feed_forward, moving(), side)[LIFT] for side in (1.0, -1.0))
    drive = parameters.drives[LIFT]
    least = 2.0 * drive.friction_torque(0.0, 0.0) - 2.0 * drive.startup_nm
    assert up - down > least / drive.stiffness_nm_rad


@pytest.mark.parametrize("square_per_nm", [0.0, 0.03])
def test_feed_forward_friction_includes_gear_load(parameters, square_per_nm):
    drive = replace(parameters.drives[LIFT], startup_nm=0.0, armature_kg_m2=0.0)
    drive = replace(drive, friction=replace(drive.friction, square_per_nm=square_per_nm))
    drives = tuple(drive if i == LIFT else each for i, each in enumerate(parameters.drives))
    alone = FeedForward(replace(parameters, drives=drives), range(5))
    weight_nm = parameters.dynamics.gravity_torques(moving().position)[LIFT]
    motor_nm = offsets(alone, moving(), 1.0)[LIFT] * drive.stiffness_nm_rad
    friction_nm = drive.friction_torque(0.0, motor_nm + weight_nm)
    assert motor_nm == pytest.approx(weight_nm + friction_nm)


def test_feed_forward_adds_inertia_of_links_and_rotor(feed_forward, parameters):
    drive = parameters.drives[LIFT]
    faster = offsets(feed_forward, moving(acceleration=0.5)) - offsets(feed_forward, moving())
    inertia = parameters.dynamics.inertia_matrix(moving().position)[LIFT, LIFT]
    lead = 0.5 * (inertia + drive.armature_kg_m2) / drive.stiffness_nm_rad
    assert faster[LIFT] == pytest.approx(lead + 0.25 * drive.delay_s**2, rel=1e-6)


def test_feed_forward_doubles_at_half_the_gain(parameters):
    stiff = FeedForward(
        replace(parameters, drives=tuple(replace(d, delay_s=0.0) for d in parameters.drives)),
        range(5),
    )
    soft = stiff.with_gains([0.5] * 5)
    point = moving(velocity=0.7, acceleration=1.0)
    np.testing.assert_allclose(offsets(soft, point, 1.0), 2.0 * offsets(stiff, point, 1.0))


def test_feed_forward_uses_identified_parameters(feed_forward, parameters):
    heavier = replace(parameters, dynamics=parameters.dynamics.with_payload(0.2))
    before, after = (
        offsets(each, moving()) for each in (feed_forward, FeedForward(heavier, range(5)))
    )
    assert abs(after[LIFT]) > abs(before[LIFT]) + 0.01


def test_feed_forward_of_unknown_motor_is_zero(parameters):
    drives = tuple(None if i == LIFT else each for i, each in enumerate(parameters.drives))
    found = offsets(FeedForward(replace(parameters, drives=drives), range(5)), moving(1.0), 1.0)
    assert found[LIFT] == 0.0
    assert found[2] != 0.0
