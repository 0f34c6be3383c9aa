"""The estimator on recordings computed from known motors, masses and payloads."""

from dataclasses import fields, replace

import numpy as np
import pytest

import ikservo
from ikservo.apps.lab.drive_fit import (
    MotorConstants,
    Winding,
    fit_backlash,
    fit_loop,
    fit_motors,
    mean_duties,
    sign_currents,
)
from ikservo.apps.lab.drive_recording import DriveRecording, smooth_samples, steady_windows
from ikservo.apps.lab.parameter_estimation import gravity_columns, identify, identify_payload
from ikservo.errors import CalibrationError
from ikservo.kinematics.dynamics import Dynamics
from ikservo.model.arm_model import link_masses
from ikservo.model.identified_drives import with_mass_scales
from tests.apps.lab.synthetic_drives import DT_S, SUPPLY_V, Drive, prior_of, record, swing
from tests.arm.identified_truth import mass_scales

MODEL = ikservo.load_model("open_manipulator_x")
DYNAMICS = Dynamics.from_masses(MODEL.chain, link_masses(MODEL, MODEL.chain))
DOF = MODEL.chain.dof
PRIORS = [prior_of()] * DOF
SCALES = (1.2, 1.2, 1.2, 1.2)


def recorded(drive=None, scales=SCALES, payload_kg=0.05, **how):
    true = with_mass_scales(DYNAMICS, scales).with_payload(payload_kg)
    return record(true, [drive or Drive()] * DOF, **how)


@pytest.fixture(scope="module")
def found():
    return identify(DYNAMICS, PRIORS, recorded())


def test_gravity_regressor_columns_sum_to_gravity_torques():
    q = np.random.default_rng(0).uniform(-1, 1, (5, DOF))
    columns = gravity_columns(DYNAMICS, q)
    assert columns.sum(axis=2) == pytest.approx(DYNAMICS.with_payload(1.0).gravity_torques(q))


def test_identification_finds_masses_and_payload(found):
    assert mass_scales(found)[1:] == pytest.approx(SCALES[1:], rel=0.04)
    assert found.payload_kg == pytest.approx(0.05, abs=0.006)


def test_identification_finds_motor_torque_from_current(found):
    for name in found.joints:
        assert found.motors[name].full_duty_nm == pytest.approx(Drive().full_nm, rel=0.02)
        assert found.motors[name].back_emf_nm_s == pytest.approx(2.3**2 / 6.5, rel=0.05)


def test_unsigned_current_identifies_motor_as_well_as_signed():
    one = recorded()
    other = sign_currents(replace(one, current_a=np.abs(one.current_a)), PRIORS)
    motors = [motors_of(recording, 1) for recording in (one, other)]
    assert motors[1].full_duty_nm == pytest.approx(motors[0].full_duty_nm, rel=0.02)


@pytest.mark.parametrize(("share", "exact"), [(0.05, 0.02), (1.0, 0.08)])
def test_motor_is_identified_despite_backlash_crossings(share, exact):
    # A motor that is faster than its joint by chance needs more current and more volts.
    clean, true, random = recorded(), Drive(), np.random.default_rng(0)
    blocks = (len(clean.time_s) // 20 + 1, DOF)
    faster = random.normal(0.0, 0.15 / share**0.5, blocks) * (random.random(blocks) < share)
    faster = np.repeat(faster, 20, axis=0)[: len(clean.time_s), :, None]
    more_a = faster * 0.5 * true.kt / true.ohm
    duty = clean.duty + (true.kt * faster + true.ohm * more_a) / SUPPLY_V
    crossing = replace(clean, duty=duty, current_a=clean.current_a + more_a)
    for joint in range(DOF):
        motors = motors_of(crossing, joint)
        assert motors.full_duty_nm == pytest.approx(true.full_nm, rel=exact)
        assert motors.back_emf_nm_s == pytest.approx(true.kt**2 / true.ohm, rel=0.05 + exact)


def motors_of(recording, joint):
    return fit_motors(steady_windows(recording).of_joint(joint), prior_of())


def test_joint_keeps_nominal_parameters_if_fit_is_not_better():
    # What is not kept aside misleads: the first joint seems to need half as much again.
    clean = recorded()
    more = 1.0 + 0.5 * (clean.leg // 2 % 4 != 1)[:, None] * np.eye(1, DOF)
    goal = clean.position + more * (clean.goal - clean.position)
    own = identify(DYNAMICS, PRIORS, replace(clean, goal=goal, duty=clean.duty * more[..., None]))
    first, second = own.joints[:2]
    assert not own.validation[first].is_better
    assert own.validation[second].is_better
    assert own.estimates[f"{first}.full_duty_nm"].value == pytest.approx(PRIORS[0].full_duty_nm)
    assert not own.estimates[f"{first}.stiffness_nm_rad"].determined


@pytest.mark.parametrize("kt_error", [-0.05, 0.0, 0.05])
@pytest.mark.parametrize("backlash_rad", [0.003, 0.03])
def test_backlash_is_motor_travel_minus_joint_travel(backlash_rad, kt_error):
    true, recording = Drive(), swing(Drive(), backlash_rad)
    recording = sign_currents(replace(recording, current_a=np.abs(recording.current_a)), PRIORS[:2])
    kt = true.kt * (1.0 + kt_error)
    motors = MotorConstants([Winding(true.ohm, kt, np.diag([0.1, 0.03]) ** 2)], SUPPLY_V)
    free = np.zeros(len(recording.time_s))
    value, error = fit_backlash(recording, 0, free, motors)
    assert value == pytest.approx(backlash_rad, rel=0.08, abs=0.001)  # or two thirds of a tick
    assert error < 0.2 * backlash_rad + 0.002
    assert fit_backlash(recording, 1, free, motors) is None
    for pressed in (free + 0.1, free - 0.1):
        assert fit_backlash(recording, 0, pressed, motors) is None


def test_quantised_current_at_rest_is_not_fitted_as_backlash():
    true, recording = Drive(), swing(Drive(), 0.01)
    last = np.flatnonzero(np.append(np.diff(recording.leg), 1))
    rows = np.sort(np.append(np.arange(len(recording.time_s)), last.repeat(round(2.0 / DT_S))))
    rests = np.append(False, rows[1:] == rows[:-1])[:, None, None]
    still = {field.name: getattr(recording, field.name)[rows] for field in fields(recording)}
    held_a = still["current_a"]
    still |= {
        "time_s": np.arange(len(rows)) * DT_S,
        "duty": np.where(rests, true.ohm * held_a / SUPPLY_V, still["duty"]),
        "current_a": np.where(rests, held_a - 0.002 * np.sign(held_a), held_a),
    }
    motors = MotorConstants([Winding(true.ohm, true.kt, np.zeros((2, 2)))], SUPPLY_V)
    value, _ = fit_backlash(DriveRecording(**still), 0, np.zeros(len(rows)), motors)
    assert value == pytest.approx(0.01, rel=0.08)


def test_identification_finds_friction(found):
    true = Drive()
    for name in found.joints[1:3]:
        own = {key: found.estimates[f"{name}.{key}"].value for key in ("coulomb_nm", "slow_nm")}
        assert sum(own.values()) == pytest.approx(true.coulomb + true.slow, rel=0.25)
        share = found.estimates[f"{name}.load"].value + found.estimates[f"{name}.slow_load"].value
        assert share == pytest.approx(true.load + true.slow_load, rel=0.15)


def test_servo_stiffness_is_gain_times_torque_at_full_duty(found):
    for name in found.joints:
        stiffness = found.estimates[f"{name}.stiffness_nm_rad"]
        assert stiffness.value == pytest.approx(Drive().gain * Drive().full_nm, rel=0.05)


def test_d_gain_effect_between_goals_is_not_fitted_as_friction(found):
    stepped = identify(DYNAMICS, PRIORS, recorded(d_gain_s=0.15))
    for name in found.joints[1:3]:
        for key in ("damping_nm_s", "coulomb_nm"):
            usual, own = (each.estimates[f"{name}.{key}"] for each in (found, stepped))
            assert own.value == pytest.approx(usual.value, abs=2.0 * usual.error)
    assert stepped.payload_kg == pytest.approx(found.payload_kg, abs=0.004)


def test_joint_moving_only_in_validation_spoils_no_other_fit():
    clean = recorded()
    aside = clean.leg // 2 % 4 == 1
    rests = replace(
        clean, speed=np.where(aside[:, None] | ~np.eye(1, DOF, dtype=bool), clean.speed, 0.0)
    )
    own = identify(DYNAMICS, PRIORS, rests)
    assert all(np.isfinite(each.value) for each in own.estimates.values())
    assert own.motors[own.joints[1]].full_duty_nm == pytest.approx(Drive().full_nm, rel=0.02)


def test_identified_model_predicts_validation_data_better(found):
    for name in found.joints[1:]:
        assert found.validation[name].identified < 0.3 * found.validation[name].nominal


def test_identification_without_current_finds_only_ratios():
    blind = identify(DYNAMICS, PRIORS, recorded(Drive(senses=False)))
    assert not blind.motors
    full = blind.estimates[f"{blind.joints[1]}.full_duty_nm"]
    assert not full.determined
    ratio = mass_scales(blind)[2] / full.value
    assert ratio == pytest.approx(SCALES[2] / Drive().full_nm, rel=0.04)


def test_load_friction_of_joint_without_weight_is_undetermined(found):
    pan, lift = found.joints[:2]
    assert not found.estimates[f"{pan}.load"].determined
    assert found.estimates[f"{pan}.load"].error > 2.0 * found.estimates[f"{lift}.load"].error


def test_identified_mass_of_first_body_is_the_most_uncertain(found):
    errors = [found.estimates[f"{body}.mass_scale"].error for body in found.bodies]
    assert errors[0] > max(errors[1:])


@pytest.mark.full
def test_true_payload_lies_within_standard_errors():
    """In seven of eight recordings the true payload is within two standard errors."""
    inside = 0
    for seed in range(8):
        one = identify(DYNAMICS, PRIORS, recorded(seed=seed, legs=10)).estimates["payload_kg"]
        inside += abs(one.value - 0.05) < 2.0 * one.error
    assert inside >= 7


def test_identified_parameters_are_never_negative():
    smooth = Drive(coulomb=0.0, load=0.0, slow=0.0, slow_load=0.0, viscous=0.0)
    found = identify(DYNAMICS, PRIORS, recorded(smooth, payload_kg=0.0))
    assert all(estimate.value >= 0.0 for estimate in found.estimates.values())


def test_identification_error_names_joint_that_did_not_move():
    with pytest.raises(CalibrationError, match=DYNAMICS.chain.names[2]):
        identify(DYNAMICS, PRIORS, recorded(dead=(2,)))


def test_payload_estimate_of_identified_arm_has_smaller_error(found):
    heavy = recorded(payload_kg=0.12, seed=5, legs=6)
    empty = identify(DYNAMICS, PRIORS, recorded(payload_kg=0.0))
    known = identify_payload(DYNAMICS, PRIORS, heavy, empty)
    unknown = identify_payload(DYNAMICS, PRIORS, heavy, None)
    assert known.value == pytest.approx(0.12, abs=0.006)
    assert known.error < unknown.error


def test_identification_excludes_samples_of_stuck_joint():
    one = recorded()
    stuck = one.position.copy()
    stuck[: len(stuck) // 2, 1] = stuck[0, 1]
    windows = steady_windows(replace(one, position=stuck))
    legs = windows.leg[windows.joint == 1]
    assert len(legs)
    assert legs.min() >= 8


def test_servo_loop_fit_finds_actual_gain_despite_wrong_prior():
    windows = steady_windows(recorded(Drive(gain=2.3))).of_joint(0)
    halved = fit_loop(windows, replace(prior_of(), gain=0.5))
    assert halved.duty_per_rad == pytest.approx(2.3, rel=0.02)


def test_servo_loop_fit_of_noisy_duty_keeps_firmware_gain():
    clean = recorded(Drive(gain=4.65))  # the firmware's is 4.61
    noise = np.random.default_rng(2).normal(scale=0.2, size=clean.duty.shape)
    windows, noisy = (steady_windows(replace(clean, duty=clean.duty + n)) for n in (0.0, noise))
    loops = [fit_loop(noisy.of_joint(j), prior_of()) for j in range(DOF)]
    assert max(abs(loop.duty_per_rad / 4.61 - 1.0) for loop in loops) < 0.005
    assert min(loop.duty_per_rad_error for loop in loops) > 0.9 * 0.02 * 4.61
    own, true = mean_duties(noisy, loops).joint_duty, windows.joint_duty
    assert np.std(own - true) < 0.15 * np.std(noisy.joint_duty - true)


def test_signal_smoothing_keeps_constant_and_reduces_noise():
    samples = np.random.default_rng(0).normal(size=(40, 2))
    assert smooth_samples(np.ones((20, 3))) == pytest.approx(np.ones((20, 3)))
    assert smooth_samples(samples).std() < samples.std()
