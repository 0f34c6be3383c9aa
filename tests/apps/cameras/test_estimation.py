from dataclasses import replace

import numpy as np
import pytest

from ikservo.apps.cameras.camera_and_arm_fit import BoardSample, Extent, estimate_camera, fit_camera
from ikservo.errors import CalibrationError
from ikservo.kinematics.bending_and_backlash import Bending
from ikservo.kinematics.dynamics import Dynamics
from ikservo.kinematics.se3 import exp_so3, make_pose
from ikservo.model import load_model
from ikservo.model.arm_model import link_masses

from .arms import SimulatedArm


@pytest.mark.full
def test_camera_fit_reduces_median_tip_error_below_1_mm(make_arm):
    before, after = [], []
    for seed in range(4):
        arm = make_arm(seed)
        samples = arm.samples()
        estimate = estimate_camera(arm.known, samples)
        q = arm.postures(100)
        before.append(arm.tip_errors_m(fit_camera(arm.known, samples, Extent.CAMERA), q))
        after.append(arm.tip_errors_m(estimate.fit, q))
        assert estimate.after_m < 0.5 * estimate.before_m
    assert np.median(before) > 0.003
    assert np.median(after) < 0.001
    assert np.percentile(after, 95) < 0.002


@pytest.mark.full
def test_leave_one_out_error_predicts_error_of_new_samples(make_arm):
    arm = make_arm(1)
    estimate = estimate_camera(arm.known, arm.samples(across_m=0.001))
    fresh = estimate.fit.residuals(arm.samples(50, across_m=0.001))
    expected = np.sqrt(np.mean(np.sum(fresh[:, :2] ** 2, axis=1)))
    assert estimate.after_m == pytest.approx(expected, rel=0.4)


@pytest.mark.full
def test_camera_fit_leaves_exact_rigid_arm_unchanged(make_arm):
    arm = make_arm(2, zeros=0.0, compliance=0.0, half_play=0.0)
    fit = estimate_camera(arm.known, arm.samples(across_m=0.001)).fit
    assert np.abs(fit.zeros).max() < np.radians(0.4)
    assert fit.bending.compliance.max() < 0.02
    assert arm.tip_errors_m(fit, arm.postures(50)).max() < 0.002


def test_camera_fit_keeps_and_marks_undetermined_parameters(make_arm):
    # The zero of the first joint turns the camera about the arm, that of the last the board.
    known = make_arm(3).known
    known = replace(known, compliance=np.array([0.07, 0.0, 0.0, 0.0, 0.0]))
    fit = fit_camera(known, make_arm(3).samples(), Extent.ARM)
    named = {parameter.name: parameter for parameter in fit.parameters}
    assert not named["shoulder_pan zero"].is_determined
    assert named["shoulder_pan zero"].value == 0.0
    assert not named["shoulder_pan compliance"].is_determined
    assert named["shoulder_pan compliance"].value == 0.07
    assert named["elbow_flex zero"].is_determined
    assert named["shoulder_lift compliance"].is_determined


def test_joint_zero_seen_only_through_bending_is_not_fitted(monkeypatch):
    model, chance = load_model("open_manipulator_x"), np.random.default_rng(1)
    lifts = np.array([0.0, 1.0, 1.0, 1.0])
    bending = Bending(
        Dynamics.from_masses(model.chain, link_masses(model, model.chain)),
        lifts * chance.uniform(0.05, 0.15, 4),
        lifts * np.radians(chance.uniform(0.1, 0.3, 4)),
    )
    arm = SimulatedArm(bending, np.radians(chance.uniform(-3.0, 3.0, 4)), chance)
    low, high = np.radians([-60, -70, -20, -60]), np.radians([60, 30, 80, 60])
    monkeypatch.setattr(arm, "postures", lambda count: chance.uniform(low, high, (count, 4)))
    samples = arm.samples(30, 0.0001, 0.0001, 0.0003)
    fit = fit_camera(arm.known, samples, Extent.ARM)
    assert fit.zeros[3] == 0.0  # 0.2° is right; half sure of it, it was -1.2°
    assert fit.zeros[1:3] == pytest.approx(arm.zeros[1:3], abs=np.radians(0.3))
    assert np.median(arm.tip_errors_m(fit, arm.postures(50))) < 0.001


def test_camera_fit_finds_compliances_that_are_not_negative(make_arm):
    arm = make_arm(4, half_play=0.0)
    fit = fit_camera(arm.known, arm.samples(30), Extent.ARM)
    assert fit.bending.compliance[1:3] == pytest.approx(arm.bending.compliance[1:3], abs=0.03)
    assert (fit.bending.compliance >= 0.0).all()


@pytest.mark.full
@pytest.mark.parametrize("wrong", [(3,), (0, 7, 19, 20)])
def test_camera_fit_rejects_outlier_pictures(make_arm, wrong):
    arm = make_arm(5)
    samples = arm.samples()
    right = [sample for i, sample in enumerate(samples) if i not in wrong]
    for i in wrong:
        T = samples[i].T_camera_board
        off = make_pose(T[:3, 3] + [0.05, -0.04, 0.1], exp_so3([1.0, 0.5, 0.0]) @ T[:3, :3])
        samples[i] = BoardSample(samples[i].q, off, samples[i].name)
    fit = estimate_camera(arm.known, samples).fit
    assert tuple(np.flatnonzero(~fit.kept)) == wrong
    expected = estimate_camera(arm.known, right).fit
    off = fit.T_camera_base @ fit.tip_poses(q := arm.postures(50))
    off -= expected.T_camera_base @ expected.tip_poses(q)
    assert np.abs(off[:, :3, 3]).max() < 0.0002


def test_camera_fit_refuses_contradictory_pictures(make_arm):
    arm = make_arm(6)
    samples = arm.samples(16)
    mixed = [BoardSample(s.q, samples[(7 * i) % 16].T_camera_board) for i, s in enumerate(samples)]
    mixed[:8] = samples[:8]
    with pytest.raises(CalibrationError, match="contradict each other"):
        estimate_camera(arm.known, mixed)


def test_wrong_board_size_is_detected_by_fitted_scale(make_arm):
    arm = make_arm(7)
    shrunk = [
        BoardSample(s.q, make_pose(s.T_camera_board[:3, 3] / 1.03, s.T_camera_board[:3, :3]))
        for s in arm.samples()
    ]
    fit = estimate_camera(arm.known, shrunk).fit
    assert fit.scale == pytest.approx(0.03, abs=0.01)


def test_camera_fit_refuses_five_pictures_as_too_few(make_arm):
    with pytest.raises(CalibrationError, match="seen in 5 pictures; at least 6"):
        estimate_camera(make_arm().known, make_arm().samples(5))
