"""Identification finds the hidden masses, friction, stiffness and payload of simulated arms."""

import math

import numpy as np
import pytest

import ikservo
from ikservo.errors import StoppedError
from ikservo.maintenance.arm_identification import IdentificationRun
from ikservo.maintenance.excitation import TourOptions, record_excitation
from tests.arm.identified_truth import friction_error, gravity_errors, stiffness_error
from tests.arm.seeds import log, part_of, spread
from tests.arm.simulated import registers

CAMPAIGN_ARMS = ("so101", "koch", "open_manipulator_x", "px100", "wx250s")
PAYLOADS_KG = {"koch": 0.03, "px100": 0.03, "wx250s": 0.15}  # what they lift in every posture
SHORT = TourOptions(postures=4, slow_postures=0)
GRAVITY, FRICTION, STIFFNESS, PAYLOAD, PAYLOAD_KG = 0.05, 0.15, 0.10, 0.10, 0.010


def identify_hidden(name, seed, tour=None):
    """Identify an arm whose masses and payload are hidden; return the errors of everything."""
    scale = 0.75 + 0.45 * spread(seed)
    payload_kg = PAYLOADS_KG.get(name, 0.1) * spread(7 * seed + 3)
    hidden = f"seed={seed}&mass_scale={scale}&payload_g={1000 * payload_kg}"
    with ikservo.open_arm(name, port=f"sim:?{hidden}") as arm:
        run = IdentificationRun.plan(arm, tour)
        run.go_to_start()
        found = run.identify(run.record())
        gravity = gravity_errors(arm, run.dynamics, found, scale, payload_kg)
        typical = np.abs(run.dynamics.gravity_torques(arm.model.chain_pose("home")))
        squares = [p.servo.friction.square_per_nm / p.force for p in run.priors()]
        pairs = list(zip(arm.chain.names, typical, squares, strict=True))
        return {
            "gravity": np.nanmax(gravity),
            "friction": max(friction_error(arm, n, found, float(g), k) for n, g, k in pairs),
            "stiffness": max(stiffness_error(arm, n, found) for n, *_ in pairs),
            "payload_kg": abs(found.payload_kg - payload_kg),
            "payload_true_kg": payload_kg,
        }


def is_within(errors):
    return (
        errors["gravity"] <= GRAVITY
        and errors["friction"] <= FRICTION
        and errors["stiffness"] <= STIFFNESS
        and errors["payload_kg"] <= max(PAYLOAD_KG, PAYLOAD * errors["payload_true_kg"])
    )


def test_a_short_tour_finds_an_arm_with_hidden_masses_and_payload():
    errors = identify_hidden("open_manipulator_x", 3, SHORT)
    assert is_within(errors), errors


def test_the_tour_starts_at_the_reference_and_not_at_the_goals_that_lead_it():
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


def test_servos_turn_slowly_to_the_goals_of_the_tour_and_to_no_others():
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
def test_fifty_hidden_arms(capsys):
    rows = []
    for seed in part_of(50):
        name = CAMPAIGN_ARMS[seed % len(CAMPAIGN_ARMS)]
        errors = identify_hidden(name, seed)
        rows.append((name, seed, errors))
        text = " ".join(f"{key} {value:.3f}" for key, value in errors.items())
        log(capsys, f"{name} {seed}: {text}{'' if is_within(errors) else '  <--'}")
    for key in ("gravity", "friction", "stiffness", "payload_kg"):
        values = [errors[key] for *_, errors in rows]
        log(capsys, f"{key}: median {np.median(values):.3f}, most {max(values):.3f}")
    assert [row[:2] for row in rows if not is_within(row[2])] == []
