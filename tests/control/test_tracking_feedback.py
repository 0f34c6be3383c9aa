"""Feedback of tracking errors: proportional, damped, bounded, kept while goals are cut."""

import math
from dataclasses import replace

import numpy as np
import pytest

from ikservo.control.tracking_feedback import TrackingFeedback
from servosim.control import DriveCommand
from servosim.motor import PARAMETERS, Motor

CYCLE_S = 0.005
TICK_RAD = 2.0 * np.pi / 4096


HEAVY_S2 = 1.5 / 18.0**2  # inertia over stiffness: it would swing more slowly than wanted


def make_feedback():
    """Return feedback of a heavy joint, whose gains add half of its stiffness."""
    feedback = TrackingFeedback(np.ones(1))
    feedback.adapt(np.array([HEAVY_S2]), np.zeros(1))
    return feedback


@pytest.fixture
def feedback():
    return make_feedback()


def fed(feedback, errors, *, left=0.0, replies=True, grow=True):
    """Return the sum of integral and fast part after each of these errors, one per cycle."""
    offsets = []
    for error, fresh in zip(errors, np.broadcast_to(replies, len(errors)), strict=True):
        feedback.update(np.array([error]), left, CYCLE_S, fresh=fresh, grow=grow)
        offsets.append(float((feedback.integral + feedback.fast)[0]))
    return np.array(offsets)


def test_feedback_is_half_the_lag_plus_an_integral(feedback):
    offsets = fed(feedback, [0.01] * 100)
    assert offsets[9] == pytest.approx(0.5 * 0.01 + 3.0 * 0.01 * 0.05, rel=0.05)
    assert offsets[-1] == pytest.approx(0.5 * 0.01 + 3.0 * 0.01 * 0.5, rel=0.05)


def test_feedback_brakes_before_the_error_changes_sign(feedback):
    offsets = fed(feedback, np.linspace(0.01, 0.0, 20))
    assert offsets[-1] < 0.0


def test_feedback_rate_is_right_with_every_other_reply_lost(feedback):
    whole, cycles = make_feedback(), np.arange(40)
    errors = 0.05 * CYCLE_S * cycles
    fed(whole, errors)
    seen = errors - 0.05 * CYCLE_S * (cycles % 2 == 0)  # the last reading again
    fed(feedback, seen, replies=cycles % 2 == 1)
    assert feedback.fast == pytest.approx(whole.fast, rel=0.02)


def test_feedback_does_not_jump_when_replies_return(feedback):
    errors = [0.0] * 10 + [0.0] * 3 + [0.1] * 10
    offsets = fed(feedback, errors, replies=[True] * 10 + [False] * 3 + [True] * 10)
    assert np.abs(np.diff(offsets)).max() < 5 * TICK_RAD


def test_feedback_rate_term_decays_without_replies(feedback):
    fed(feedback, np.linspace(0.0, 0.01, 20))
    integral = feedback.integral.copy()
    fed(feedback, [0.01] * 40, replies=False)
    assert feedback.fast == 0.0
    np.testing.assert_array_equal(feedback.integral, integral)


def test_feedback_counts_only_error_beyond_its_dead_band(feedback):
    fed(feedback, [0.003] * 20, left=0.004)
    assert feedback.fast == feedback.integral == 0.0
    fed(feedback, [0.003] * 20, left=0.002)
    assert feedback.fast == pytest.approx(0.5 * 0.001)


def test_feedback_does_not_grow_while_goals_are_limited(feedback):
    before = fed(feedback, [0.01] * 10)[-1]
    assert max(fed(feedback, np.linspace(0.01, 0.1, 50), grow=False)) <= before
    assert fed(feedback, [-0.01], grow=False)[0] < before


def test_feedback_integral_grows_slower_near_maximum_lead(feedback):
    fed(feedback, [0.01] * 100, grow=0.25)
    slow = float(feedback.integral[0])
    assert slow == pytest.approx(0.25 * 3.0 * 0.01 * 0.5)
    fed(feedback, [-0.01] * 10, grow=0.25)
    assert slow - feedback.integral[0] == pytest.approx(3.0 * 0.01 * 0.05)


def test_tracking_feedback_integral_is_kept_until_reset(feedback):
    fed(feedback, [0.01] * 100)
    integral = feedback.integral.copy()
    feedback.begin()
    np.testing.assert_array_equal(feedback.fast, 0.0)
    np.testing.assert_array_equal(feedback.integral, integral)
    feedback.reset()
    np.testing.assert_array_equal(feedback.integral, 0.0)


def moved(feedback, errors, direction):
    """Feed the errors of a joint that moves in a direction; return the friction afterwards."""
    for error in errors:
        feedback.update(np.array([error]), 0.0, CYCLE_S, grow=True, direction=direction)
    return float(feedback.friction[0])


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_feedback_learns_friction_from_lag_during_motion(feedback, direction):
    assert moved(feedback, [0.002 * direction] * 100, direction) == pytest.approx(0.002)
    assert moved(feedback, [0.002 * direction] * 100, 0.0) == pytest.approx(0.002)
    feedback.begin()
    assert moved(feedback, [-0.002 * direction] * 50, direction) == pytest.approx(0.001)
    assert moved(feedback, [0.1] * 1000, 1.0) == pytest.approx(0.03)
    feedback.reset()
    assert feedback.friction == 0.0


def swing(amplitude_rad, hz, seconds):
    return amplitude_rad * np.cos(2.0 * np.pi * hz * CYCLE_S * np.arange(seconds / CYCLE_S))


def strongest_answer(feedback, errors):
    """Return the largest fast part, and that of a feedback that has seen no swing before."""
    fresh = make_feedback()
    answers = []
    for each in (feedback, fresh):
        each.begin()
        fed(each, errors)
        answers.append(abs(float(each.fast[0])))
    return answers


@pytest.mark.parametrize("hz", [10.0, 20.0])
def test_feedback_does_not_excite_oscillation_and_recovers(feedback, hz):
    fed(feedback, swing(0.01, hz, 2.0))
    swinging, fresh = strongest_answer(feedback, [0.005] * 20)
    assert swinging < 0.1 * fresh
    fed(feedback, [0.0] * 5000)
    recovered, fresh = strongest_answer(feedback, [0.005] * 20)
    assert recovered == pytest.approx(fresh)


@pytest.mark.parametrize(
    "errors", [swing(0.003, 10.0, 2.0), swing(0.01, 5.0, 4.0), [0.0, 0.03, 0.0, 0.0], [0.02, -0.02]]
)
def test_feedback_gain_stays_after_small_or_slow_oscillation(feedback, errors):
    fed(feedback, errors)
    answer, fresh = strongest_answer(feedback, [0.005] * 20)
    assert answer == pytest.approx(fresh)


def test_feedback_gain_is_lower_for_unloaded_joint():
    lag, inertia_s2 = [0.01] * 200, np.array([0.8 / 18.0**2])
    stiffness, braking = [], []
    for pressed in (0.0, 1.0):
        feedback = TrackingFeedback(np.ones(1))
        feedback.adapt(inertia_s2, np.array([pressed]))
        fed(feedback, lag)
        stiffness.append(float(feedback.fast[0]) / 0.01)
        feedback.begin()
        fed(feedback, 0.02 * CYCLE_S * (np.arange(80) - 79) - 1e-9)
        braking.append(float(feedback.fast[0]) / 0.02)
    assert stiffness == pytest.approx([0.8 - 1.0, 0.8 * (30 / 18) ** 2 - 1.0])
    assert braking == pytest.approx([28 * inertia_s2[0], 40 * inertia_s2[0]], rel=0.1)


def test_feedback_with_unknown_inertia_only_brakes():
    feedback = TrackingFeedback(np.ones(1))
    fed(feedback, [0.01] * 200)
    assert feedback.fast == pytest.approx(0.0, abs=1e-6)
    fed(feedback, [0.009])
    assert feedback.fast < 0.0


def error_rad(motor, p_gain, feedback=None):
    """Return the rms error of a joint at constant speed, and of its rest after that.

    Goals lead by friction and damping, and by the feedback.
    """
    parameters, drive = motor.parameters, DriveCommand(True, kp=p_gain, tick_rad=TICK_RAD)
    full_nm = parameters.duty_torque_nm
    braked_nm_s = parameters.torque_constant_nm_a**2 / parameters.resistance_ohm
    errors = []
    for k in range(2000):
        moving = k < 1000
        speed_rad_s = 0.5 * moving
        reference = 0.0005 * min(k, 1000)
        if k % 5 == 0:
            if feedback is not None:
                error = np.array([reference - TICK_RAD * round(motor.position_rad / TICK_RAD)])
                feedback.update(error, 0.0, CYCLE_S, grow=1.0, direction=float(moving))
            slow_nm = parameters.stribeck_nm * math.exp(-speed_rad_s / parameters.stribeck_rad_s)
            taken_nm = (braked_nm_s + parameters.viscous_nm_s) * speed_rad_s
            taken_nm += moving * (parameters.friction_nm + slow_nm)
            added = 0.0 if feedback is None else float((feedback.fast + feedback.integral)[0])
            lead = taken_nm / (p_gain * full_nm) + added
            drive.goal_rad = TICK_RAD * round((reference + lead) / TICK_RAD)
        motor.step(0.001, 0.0, drive, parameters.nominal_v)
        errors.append(reference - motor.position_rad)
    return float(np.sqrt(np.mean(np.square(errors))))


@pytest.mark.sample(4)
@pytest.mark.parametrize(
    ("model", "p_gain"), [("STS3215", 5.2), ("STS3215-C018", 5.2), ("XM430-W350", 5.3)]
)
@pytest.mark.parametrize("output_nm", [0.002, 0.02])
@pytest.mark.parametrize("inertia_kg_m2", [0.005, 0.05])
def test_feedback_adds_at_most_25_percent_to_oscillation(model, p_gain, output_nm, inertia_kg_m2):
    parameters = replace(PARAMETERS[model], output_friction_nm=output_nm)
    stiffness = p_gain * parameters.duty_torque_nm
    alone, together = [], []
    for play_deg in (0.5, 1.0, 2.0):
        play = replace(parameters, backlash_rad=math.radians(play_deg))
        feedback = TrackingFeedback(np.ones(1))
        inertia_s2 = (inertia_kg_m2 + play.armature_kg_m2) / stiffness
        feedback.adapt(np.array([inertia_s2]), np.zeros(1))
        for errors, own in ((alone, None), (together, feedback)):
            motor = Motor(play)
            motor.load_inertia_kg_m2 = inertia_kg_m2
            errors.append(error_rad(motor, p_gain, own))
    assert max(np.divide(together, alone)) < 1.25
