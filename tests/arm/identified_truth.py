"""True parameters of a simulated arm, compared with the identified ones."""

import numpy as np

from ikservo.apps.lab.duty_model import JOINT_PARAMETERS
from ikservo.apps.lab.parameter_estimation import gravity_columns
from tests.arm.simulated import line_of

SPEEDS_RAD_S = (0.1, 0.3, 0.8)


def mass_scales(found):
    """Return the identified scale of each body's mass."""
    return np.array([found.estimates[f"{body}.mass_scale"].value for body in found.bodies])


def gravity_errors(arm, dynamics, found, scale, payload_kg, seed=0, postures=300):
    """Return the rms error of each joint's gravity torque as a fraction of the largest joint's rms.

    Joints with an rms below a hundredth of the largest one are left out: NaN.
    """
    chain = arm.model.chain
    lower, upper = np.maximum(chain.lower_rad, -np.pi), np.minimum(chain.upper_rad, np.pi)
    q = np.random.default_rng(seed).uniform(lower, upper, (postures, chain.dof))
    columns = gravity_columns(dynamics, q)
    true = columns @ np.append(np.full(len(found.bodies), scale), payload_kg)
    error = columns @ np.append(mass_scales(found), found.payload_kg) - true
    rms, own = np.sqrt((error**2).mean(axis=0)), np.sqrt((true**2).mean(axis=0))
    return np.where(own > 0.01 * own.max(), rms / np.maximum(own, 1e-9), np.nan)


def friction_error(arm, name, found, gravity_nm, square_per_nm):
    """Return the relative rms error of the torque that motion needs beyond gravity.

    It is computed for up and down motion at a few speeds, without load and with a load of either
    sign. The part that grows with the square of the load is taken from the tables.
    """
    servos = line_of(arm).world.joint(name).servos
    cases = [
        (speed, load, side)
        for speed in SPEEDS_RAD_S for load in (0.0, gravity_nm, -gravity_nm) for side in (1, -1)
    ]  # fmt: skip
    true = np.array([_true_effort(servos, *case) for case in cases])
    own = np.array([_found_effort(found, name, square_per_nm, *case) for case in cases])
    return float(np.sqrt(((own - true) ** 2).sum() / (true**2).sum()))


def stiffness_error(arm, name, found):
    servos = line_of(arm).world.joint(name).servos
    true = sum(s.drive.kp * s.motor.parameters.duty_torque_nm for s in servos)
    return abs(found.estimates[f"{name}.stiffness_nm_rad"].value / true - 1.0)


def play_error(arm, name, found):
    """Return the error of the backlash in units of 0.3° or 30 %; 0 if it is not determined.

    Only servos that measure their current may leave it undetermined.
    """
    motor = line_of(arm).world.joint(name).servos[0].motor.parameters
    estimate = found.estimates.get(f"{name}.backlash_rad")
    if estimate is None:
        return np.inf if name in found.motors else 0.0
    off = abs(estimate.value - motor.backlash_rad)
    return off / max(np.radians(0.3), 0.3 * motor.backlash_rad)


def _true_effort(servos, speed, gravity_nm, side):
    return sum(
        _effort_of(s.motor.parameters, speed, gravity_nm / len(servos), side) for s in servos
    )


def _effort_of(motor, speed, gravity_nm, side):
    """Solve the motor's equations by repeated substitution."""
    slow = np.exp(-speed / motor.stribeck_rad_s)
    shaft = gravity_nm
    for _ in range(200):
        load = abs(shaft + gravity_nm)
        dry = motor.friction_nm + motor.load_friction * load + motor.load_square_per_nm * load**2
        dry += slow * (motor.stribeck_nm + motor.load_stribeck * load)
        shaft = gravity_nm + side * (dry + motor.viscous_nm_s * speed)
    brake = motor.torque_constant_nm_a**2 / motor.resistance_ohm
    return shaft + side * brake * speed - gravity_nm


def _found_effort(found, name, square, speed, gravity_nm, side):
    own = dict(zip(JOINT_PARAMETERS, found.joint(name), strict=True))
    motors = found.motors.get(name)
    brake = min(motors.back_emf_nm_s, own["damping_nm_s"]) if motors else own["damping_nm_s"]
    slow, shaft = np.exp(-speed / own["slow_rad_s"]), gravity_nm
    for _ in range(200):
        load = abs(shaft + gravity_nm)
        dry = own["coulomb_nm"] + own["load"] * load + square * load**2
        dry += slow * (own["slow_nm"] + own["slow_load"] * load)
        shaft = gravity_nm + side * (dry + (own["damping_nm_s"] - brake) * speed)
    return shaft + side * brake * speed - gravity_nm
