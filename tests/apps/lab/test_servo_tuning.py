"""Servo tuning: figures of a response, restored gains, suggestions that do not oscillate."""

from types import SimpleNamespace

import numpy as np
import pytest

from ikservo.apps.workbench.gain_search import (
    StepResponse,
    Trial,
    gain_registers,
    keeping_gains,
    measure_response,
    record_joint,
    search_gains,
)
from ikservo.arm.opening import open_own_arm, servo_specs
from ikservo.control.loop import ControlCycle
from ikservo.errors import BadValueError, RefusedError
from ikservo.model import load_model

STEP_RAD = np.radians(10)


def second_order(damping, natural_rad_s=30.0, lag_s=0.0, swing_rad=0.0, short_rad=0.0):
    """Return the response of an oscillator with known figures to a quick ramp there and back."""
    time_s = np.arange(0.0, 2.4, 0.002)
    goal = np.interp(time_s, (0.0, 0.2, 1.2, 1.4), (0.0, STEP_RAD, STEP_RAD, 0.0))
    position, speed, rows = 0.0, 0.0, []
    for late_s in time_s - lag_s:
        wanted = np.interp(late_s, time_s, goal)
        speed += 0.002 * (
            natural_rad_s**2 * (wanted - position) - 2 * damping * natural_rad_s * speed
        )
        position += 0.002 * speed
        rows.append(position)
    shake = swing_rad / 2 * np.sin(2 * np.pi * 6.0 * time_s)
    return StepResponse(time_s, goal, np.array(rows) - short_rad + shake, (0.2, 1.4))


def test_step_response_overshoots_only_without_damping():
    calm, wild = second_order(1.2), second_order(0.15)
    assert np.degrees(calm.overshoot_rad) < 0.1
    assert np.degrees(wild.overshoot_rad) > 0.8
    assert calm.settling_s < 0.2 < wild.settling_s
    assert not calm.swings
    assert calm.cost < wild.cost


@pytest.mark.parametrize("lag_s", [0.01, 0.03])
def test_lag_of_step_response_equals_delay_of_servo(lag_s):
    extra_s = second_order(1.0, 300.0, lag_s).lag_s - second_order(1.0, 300.0).lag_s
    assert extra_s == pytest.approx(lag_s, abs=0.004)


def test_step_response_tells_oscillation_from_steady_error():
    swinging = second_order(1.0, swing_rad=np.radians(0.6))
    assert swinging.swing_rad == pytest.approx(np.radians(0.6), rel=0.1)
    assert swinging.swings
    short = second_order(1.0, short_rad=np.radians(0.5))
    assert short.steady_error_rad == pytest.approx(np.radians(0.5), rel=0.1)
    assert not short.swings


@pytest.fixture
def arm():
    with open_own_arm(load_model("so101"), "sim:?pose=home") as arm:
        yield arm


def servo_of(arm, joint):
    return next(spec for spec in servo_specs(arm.model) if spec.name == joint)


def raw_gains(arm, servo):
    return [arm.context.servos.bus.read(servo.id, r, raw=True) for r in gain_registers(servo)]


@pytest.mark.campaign
def test_suggested_gains_track_better_and_old_ones_are_restored(arm):
    servo, bus = servo_of(arm, "shoulder_lift"), arm.context.servos.bus
    before = raw_gains(arm, servo)
    with keeping_gains(bus, servo) as present:
        first = Trial(present, measure_response(arm, servo.name, STEP_RAD))
        trials = [first, *search_gains(arm, servo, first, STEP_RAD)]
    best = min(trials, key=lambda one: one.response.cost)
    assert best.response.cost < first.response.cost
    assert not best.response.swings
    assert raw_gains(arm, servo) == before
    assert bus.read(servo.id, servo.table.eeprom_lock, raw=True) == 1


def test_servo_gains_are_restored_if_tuning_trial_fails(arm):
    servo, bus = servo_of(arm, "elbow_flex"), arm.context.servos.bus
    before = raw_gains(arm, servo)

    def try_too_far():
        with keeping_gains(bus, servo) as present:
            bus.write_until_power_off(servo.id, next(iter(present)), 10)
            measure_response(arm, servo.name, np.radians(300))

    with pytest.raises(RefusedError, match="has no room"):
        try_too_far()
    assert raw_gains(arm, servo) == before


def test_servo_gains_of_trial_are_lost_at_power_off(arm):
    servo, bus = servo_of(arm, "elbow_flex"), arm.context.servos.bus
    held = bus.port.transport.line.servos[servo.id]
    before = held.read("p_gain")
    bus.write_until_power_off(servo.id, servo.table.p_gain, before + 3)
    assert held.read("p_gain") == before + 3
    held.power_down()
    held.power_up()
    assert held.read("p_gain") == before


@pytest.mark.parametrize("step_rad", [0.0, 1e-5, float("nan")])
def test_servo_tuning_refuses_step_too_small_to_measure(arm, step_rad):
    with pytest.raises(BadValueError, match="at least 1°"):
        measure_response(arm, "elbow_flex", step_rad)


def test_second_ctrl_c_during_tuning_still_restores_gains(arm, monkeypatch):
    servo, bus = servo_of(arm, "elbow_flex"), arm.context.servos.bus
    before, write = raw_gains(arm, servo), bus.write_until_power_off
    presses = iter([KeyboardInterrupt])

    def interrupted(servo_id, register, raw):
        if raw in before and next(presses, None):
            raise KeyboardInterrupt
        write(servo_id, register, raw)

    def leave_with_a_second_press():
        with keeping_gains(bus, servo) as present:
            write(servo.id, next(iter(present)), 10)
            monkeypatch.setattr(bus, "write_until_power_off", interrupted)

    with pytest.raises(KeyboardInterrupt):
        leave_with_a_second_press()
    assert raw_gains(arm, servo) == before


def test_recorded_step_response_has_one_sample_per_time():
    class Runner:
        def run(self, _make, record, _speed, *, compensated):
            for time_s, goal in ((0.0, 0.0), (0.01, 0.1), (0.01, 0.2), (0.02, 0.3), (0.02, 0.3)):
                joints = np.array([goal, 5.0])
                record(ControlCycle(time_s, 0.02, joints, joints, joints - 0.1, ()))

    arm = SimpleNamespace(runner=Runner())
    times, goals, positions = record_joint(arm, 0, None)
    assert times.tolist() == [0.0, 0.01, 0.02]
    assert goals.tolist() == [0.0, 0.2, 0.3]
    assert np.isfinite(StepResponse(times, goals, positions, (0.01, 0.02)).lag_s)
