"""Identification finds the hidden masses, friction, stiffness and payload of simulated arms."""

import math
from datetime import UTC, datetime

import numpy as np
import pytest

import ikservo
from ikservo.apps.lab.arm_identification import IdentificationRun
from ikservo.apps.lab.excitation import TourOptions, record_excitation
from ikservo.calibration.identified_file import save_identified
from ikservo.errors import IkservoError, StoppedError
from tests.arm.identified_truth import (
    friction_error,
    gravity_errors,
    play_error,
    stiffness_error,
)
from tests.arm.seeds import log, part_of
from tests.arm.simulated import registers, true_tip_m

FAMILY = ("so101", "koch", "open_manipulator_x")
SHORT = TourOptions(postures=4, slow_postures=0, swings=3)


@pytest.mark.campaign
def test_short_excitation_identifies_hidden_masses_and_payload():
    scale, payload_kg = 1.13, 0.08
    hidden = f"seed=3&mass_scale={scale}&payload_g={1000 * payload_kg}"
    with ikservo.open_arm("open_manipulator_x", port=f"sim:?{hidden}") as arm:
        run = IdentificationRun.plan(arm, SHORT)
        run.go_to_start()
        found = run.identify(run.record())
        assert np.nanmax(gravity_errors(arm, run.dynamics, found, scale, payload_kg)) <= 0.05
        typical = np.abs(run.dynamics.gravity_torques(arm.model.chain_pose("home")))
        for name, gravity_nm, prior in zip(arm.chain.names, typical, run.priors(), strict=True):
            square = prior.servo.friction.square_per_nm / prior.force
            assert friction_error(arm, name, found, float(gravity_nm), square) <= 0.15
            assert stiffness_error(arm, name, found) <= 0.10
            assert play_error(arm, name, found) <= 1.0
    assert found.payload_kg == pytest.approx(payload_kg, abs=0.01)


@pytest.mark.full
def test_excitation_starts_at_reference_not_at_leading_goal():
    with ikservo.open_arm("so101", port="sim:") as arm:
        run = IdentificationRun.plan(arm, SHORT)
        run.go_to_start()
        reference, goals = arm.context.servos.reference(), arm.context.servos.goals()
        cycles = []

        def stop_at_once(cycle):
            cycles.append(cycle)
            arm.stop("seen")

        with pytest.raises(StoppedError):
            record_excitation(arm.context, arm.runner, run.excitation, stop_at_once)
    assert np.abs(goals - reference).max() > math.radians(0.2)
    np.testing.assert_allclose(cycles[0].reference, reference, atol=math.radians(0.02))


@pytest.mark.full
def test_servos_use_slow_profile_speed_during_excitation():
    with ikservo.open_arm("koch", port="sim:") as arm:
        run = IdentificationRun.plan(arm, SHORT)
        run.go_to_start()
        touring = []

        def stop_at_once(_):
            touring.append(max(registers(arm, "profile_velocity").values()))
            arm.stop("seen")

        with pytest.raises(StoppedError):
            record_excitation(arm.context, arm.runner, run.excitation, stop_at_once)
        arm.acknowledge()
        arm.move_joints({"shoulder_pan": 0.1}, speed="normal")
        slow, normal = (arm.model.speed(speed).rad_s for speed in ("slow", "normal"))
        usual = max(registers(arm, "profile_velocity").values())
    assert touring[0] == pytest.approx(usual * slow / normal, abs=1)


@pytest.mark.campaign
@pytest.mark.timeout(0)
def test_identification_reduces_path_error_of_20_arms(capsys):
    ratios, wrong = [], []
    for seed in part_of(20):
        name, port = FAMILY[seed % len(FAMILY)], f"sim:?seed={seed + 1}"
        known, off = identify_member(name, port)
        wrong += [(name, seed, *each) for each in off]
        before = path_error_m(name, port)
        path = save_identified(known)
        ratios.append(path_error_m(name, port) / before)
        path.unlink()
        log(
            capsys, f"{name} {seed + 1}: {1000 * before:.2f} mm, then times {ratios[-1]:.2f}; {off}"
        )
    log(
        capsys,
        f"path error: times {np.median(ratios):.2f} in the median, {max(ratios):.2f} at most",
    )
    assert wrong == []
    assert np.median(ratios) < 1.0
    assert max(ratios) <= 1.1


def identify_member(name, port):
    """Identify an arm of the family; return its file and the values outside the bounds."""
    with ikservo.open_arm(name, port=port) as arm:
        run = IdentificationRun.plan(arm)
        run.go_to_start()
        found = run.identify(run.record())
        off = [
            (joint, what, error)
            for joint in arm.chain.names
            for what, error, most in (
                ("stiffness", stiffness_error(arm, joint, found), 0.15),
                ("play", play_error(arm, joint, found), 1.0),
            )
            if not error <= most
        ]
        return run.file(found, datetime.now(UTC)), off


def path_error_m(name, port, lines=20):
    """Return the median of the true tip's rms distance from the same random lines, m."""
    dice, errors = np.random.default_rng(1), list[float]()
    with ikservo.open_arm(name, port=port) as arm:
        arm.pose("home")
        while len(errors) < lines:
            end = arm.where().tip_m + dice.uniform(-0.1, 0.1, 3)
            try:
                plan = arm.plan_line(end, speed="normal")
            except IkservoError:
                continue
            begin, tips = arm.chain.forward(plan.start[: arm.chain.dof])[:3, 3], list[np.ndarray]()
            arm.execute(plan, lambda _, tips=tips: tips.append(true_tip_m(arm)))
            along = (end - begin) / np.linalg.norm(end - begin)
            gone = np.array(tips) - begin
            beside = np.linalg.norm(gone - np.outer(gone @ along, along), axis=1)
            errors.append(float(np.sqrt(np.mean(beside**2))))
    return float(np.median(errors))
