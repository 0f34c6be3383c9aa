"""The lag at which servos lift their arm, compared with the simulated motors' friction."""

import math
from dataclasses import replace

import numpy as np
import pytest

from ikservo.kinematics import Dynamics
from ikservo.model import load_model
from ikservo.model.arm_model import link_masses
from ikservo.model.load_lag import load_lags
from ikservo.model.servo_torque import find_servo_torque
from servosim.joint import STEP_S
from servosim.motor import Motor, solve_velocity
from servosim.parameters import PARAMETERS
from tests.oracle import ARMS


def breakaway_nm(servo, load_nm):
    """Return the torque at which a simulated motor's dry friction no longer holds a load."""
    motor = Motor(replace(PARAMETERS[servo], backlash_rad=0.0))
    torques = np.linspace(load_nm, 6.0 * load_nm, 20_000)
    steps = [motor.begin_motion(STEP_S, t, -load_nm) for t in torques]
    moves = [solve_velocity(step, -load_nm) > 0.0 for step in steps]
    return float(torques[moves.index(True)])


@pytest.mark.parametrize(("name", "joint", "servo", "count", "stiffness_nm_rad"), [
    ("omx_f", "joint2", "XL430-W250", 1, 9.09), ("wx250s", "shoulder", "XM430-W350", 2, 39.8),
    ("so101", "shoulder_lift", "STS3215", 1, 17.5), ("koch", "elbow_flex", "XL330-M288", 1, 2.67),
])  # fmt: skip
def test_allowed_lifting_lag_suffices_in_heaviest_posture(
    name, joint, servo, count, stiffness_nm_rad
):
    model = load_model(name)
    dynamics = Dynamics.from_masses(model.chain, link_masses(model, model.chain))
    lower, upper = np.maximum(model.chain.lower_rad, -math.pi), np.minimum(model.chain.upper_rad, 3)
    postures = np.random.default_rng(5).uniform(lower, upper, (2000, model.chain.dof))
    column = model.chain.names.index(joint)
    load_nm = max(abs(dynamics.gravity_torques(q)[column]) for q in postures)
    needed_rad = count * breakaway_nm(servo, load_nm / count) / stiffness_nm_rad
    assert needed_rad <= load_lags(model, model.chain)[joint].lifting_rad <= 1.45 * needed_rad


@pytest.mark.parametrize("name", ARMS)
def test_joints_with_known_servo_have_allowed_lifting_lag(name):
    model = load_model(name)
    lags = load_lags(model, model.chain)
    assert list(lags) == list(model.chain.names)
    assert all(0.0 < lag.lifting_rad < 0.2 for lag in lags.values())


@pytest.mark.parametrize("name", sorted(set(ARMS) - {"planar2", "planar3"}))  # gravity is across
def test_payload_increases_allowed_lifting_lag(name):
    model = load_model(name)
    empty = load_lags(model, model.chain)
    loaded = load_lags(model, model.chain, 0.1)
    more = {joint: loaded[joint].lifting_rad - lag.lifting_rad for joint, lag in empty.items()}
    assert min(more.values()) >= 0.0
    assert max(more.values()) > 0.005


@pytest.mark.parametrize("name", ARMS)
def test_allowed_lifting_lag_stays_below_overload(name):
    model = load_model(name)
    for joint, lag in load_lags(model, model.chain, 5.0).items():
        servo = model.joint(joint).servo.model
        torque = find_servo_torque(servo, model.supply_v)
        duty = lag.lifting_rad * torque.stiffness_nm_rad / torque.full_duty_nm
        assert duty + torque.startup_duty < (0.8 if servo.startswith("STS") else 0.9)


def test_computed_sag_includes_link_weight_and_payload():
    model = load_model("open_manipulator_x")
    empty, loaded = (load_lags(model, model.chain, kg)["joint2"].sag_rad for kg in (0.0, 0.5))
    assert math.degrees(empty) == pytest.approx(2.5, abs=0.3)
    assert math.degrees(loaded) == pytest.approx(7.6, abs=0.5)


def test_allowed_lifting_lag_needs_known_servo_and_masses():
    model = load_model("so101")
    first, *others = model.joints
    unknown = replace(first, servo=replace(first.servo, model="XC999"))
    assert first.name not in load_lags(replace(model, joints=(unknown, *others)), model.chain)
    weightless = replace(model.urdf, links=tuple(replace(k, mass_kg=0.0) for k in model.urdf.links))
    assert load_lags(replace(model, urdf=weightless), model.chain) == {}
