"""Sine response of a servo: phase lag and amplitude of known systems, limits, restored gains."""

import numpy as np
import pytest

from ikservo.apps.workbench.gain_search import keeping_gains, tunable_registers, write_gains
from ikservo.apps.workbench.servo_sine import SineMotion, SineResponse, measure_sine
from ikservo.arm.opening import open_own_arm
from ikservo.errors import BadValueError, RefusedError
from ikservo.model import load_model
from tests.apps.lab.test_servo_tuning import servo_of

AMPLITUDE_RAD = np.radians(2.0)


def sine(from_hz, to_hz):
    return SineMotion(np.array([0.3, -0.2]), 1, AMPLITUDE_RAD, from_hz, to_hz)


def response_of(motion, follow):
    """Return the response of a joint that follows goals by a function of goals and step."""
    time_s = np.arange(0.0, motion.duration_s, 0.002)
    goal = np.array([motion.state(t).position[1] for t in time_s])
    return SineResponse(time_s, goal, follow(goal, 0.002), motion)


def low_pass(time_constant_s):
    def follow(goal, step_s):
        position, rows = goal[0], []
        for each in goal:
            position += step_s / time_constant_s * (each - position)
            rows.append(position)
        return np.array(rows)

    return follow


@pytest.mark.parametrize(("from_hz", "to_hz"), [(2.0, 2.0), (0.5, 4.0)])
def test_sine_response_of_first_order_lag_matches_formula(from_hz, to_hz):
    points = response_of(sine(from_hz, to_hz), low_pass(0.05)).points
    assert len(points) == (1 if from_hz == to_hz else 6)
    for each in points:
        expected = 1 / (1 + 2j * np.pi * each.frequency_hz * 0.05)
        assert each.amplitude_ratio == pytest.approx(abs(expected), abs=0.02)
        assert each.phase_lag_rad == pytest.approx(-np.angle(expected), abs=np.radians(2))


@pytest.mark.parametrize("late_s", [0.0, 0.1, 0.2])
def test_sine_delay_is_right_for_phase_lag_above_180_deg(late_s):
    def follow(goal, step_s):
        late = round(late_s / step_s)
        return np.concatenate([np.full(late, goal[0]), goal])[: len(goal)]

    (point,) = response_of(sine(3.0, 3.0), follow).points
    assert point.phase_lag_rad == pytest.approx(2 * np.pi * 3.0 * late_s, abs=0.02)
    assert point.amplitude_ratio == pytest.approx(1.0, abs=0.01)


def test_sine_motion_starts_and_ends_at_rest():
    motion = sine(2.0, 4.0)
    times_s = np.arange(0.0, motion.duration_s, 1e-3)
    states = [motion.state(t) for t in times_s]
    q, v, a = (np.array([getattr(each, name)[1] for each in states])
               for name in ("position", "velocity", "acceleration"))  # fmt: skip
    assert np.gradient(q, 1e-3)[2:-2] == pytest.approx(v[2:-2], abs=2e-3)
    assert np.gradient(v, 1e-3)[2:-2] == pytest.approx(a[2:-2], abs=0.1)
    for end in (0, -1):
        assert q[end] == pytest.approx(-0.2)
        assert (v[end], a[end]) == pytest.approx((0.0, 0.0), abs=1e-3)
    assert np.abs(q + 0.2).max() == pytest.approx(AMPLITUDE_RAD, rel=1e-3)


def test_sine_test_detects_oscillation_at_rest():
    motion = sine(2.0, 2.0)
    calm = response_of(motion, lambda goal, _: goal)
    shaken = response_of(
        motion, lambda goal, _: goal + 0.01 * np.sin(30 * np.arange(len(goal)) * 2e-3)
    )
    assert calm.swing_rad < 1e-6
    assert shaken.swing_rad == pytest.approx(0.02, rel=0.05)


@pytest.fixture
def arm():
    with open_own_arm(load_model("so101"), "sim:?pose=home") as arm:
        yield arm


@pytest.mark.parametrize(
    ("amplitude_deg", "hz", "said"),
    [
        (3.0, (5.0, 5.0), "would need"),
        (170.0, (0.1, 0.1), "no room"),
        (0.1, (1.0, 1.0), "at least 0.5°"),
        (2.0, (3.0, 1.0), "the lower one first"),
        (2.0, (0.0, 1.0), "0.1 to 20"),
        (float("nan"), (1.0, 1.0), "at least 0.5°"),
    ],
)
def test_sine_outside_joint_limits_moves_nothing(arm, amplitude_deg, hz, said):
    before = arm.context.servos.measure_positions()
    with pytest.raises((RefusedError, BadValueError), match=said):
        measure_sine(arm, "elbow_flex", np.radians(amplitude_deg), *hz)
    assert np.abs(arm.context.servos.measure_positions() - before).max() < np.radians(0.5)


@pytest.mark.full
def test_sine_test_tries_registers_and_restores_them(arm):
    servo, bus = servo_of(arm, "elbow_flex"), arm.context.servos.bus
    held = bus.port.transport.line.servos[servo.id]
    registers = tunable_registers(servo)
    before = {each.name: held.read(each.name) for each in registers}
    assert {"i_gain", "min_startup_force", "cw_dead_zone", "ccw_dead_zone"} < set(before)
    with keeping_gains(bus, servo, registers) as present:
        assert {each.name: raw for each, raw in present.items()} == before
        write_gains(bus, servo, {each: raw + 1 for each, raw in present.items()})
        assert {name: held.read(name) - 1 for name in before} == before
        response = measure_sine(arm, "elbow_flex", AMPLITUDE_RAD, 1.5, 1.5)
    assert {name: held.read(name) for name in before} == before
    held.power_down()
    held.power_up()
    assert {name: held.read(name) for name in before} == before
    (point,) = response.points
    assert 0.8 < point.amplitude_ratio < 1.2
    assert 0.1 < point.phase_lag_rad < 1.0
