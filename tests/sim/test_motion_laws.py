"""Commanded motions of each family, compared with the closed form of their profile."""

from __future__ import annotations

import math

import pytest

RPM = 2 * math.pi / 60
TICK = 2 * math.pi / 4096

TRAVEL = 1200

# fmt: off
PROFILES = {
    # model: registers of the profile, speed [tick/s], acceleration [tick/s²]
    "STS3215":    ({"goal_speed": 1000, "acceleration": 20},
                   1000, 2000),
    "XM430-W350": ({"profile_velocity": 100, "profile_acceleration": 10},
                   22.9 * RPM / TICK, 2145.77 * RPM / 60 / TICK),
    "MX-28":      ({"moving_speed": 150, "goal_acceleration": 20},
                   17.1 * RPM / TICK, math.radians(171.66) / TICK),
}
# fmt: on


def trapezoid(time_s, travel, speed, acceleration):
    """Return the position on a trapezoid (or triangle) that starts and ends at rest."""
    ramp_s = min(speed / acceleration, math.sqrt(travel / acceleration))
    speed = acceleration * ramp_s
    cruise_s = travel / speed - ramp_s
    if time_s < ramp_s:
        return acceleration * time_s**2 / 2
    if time_s < ramp_s + cruise_s:
        return speed * (time_s - ramp_s / 2)
    rest_s = max(0.0, 2 * ramp_s + cruise_s - time_s)
    return travel - acceleration * rest_s**2 / 2


@pytest.mark.parametrize("model", PROFILES)
def test_servo_profile_follows_trapezoid_within_1_percent(make_port, model):
    registers, speed, acceleration = PROFILES[model]
    port = make_port(model)
    servo = port.line.servos[1]
    servo.write("torque_enable", 1)
    for name, value in registers.items():
        servo.write(name, value)
    servo.write("goal_position", 2048 + TRAVEL)
    start_s = port.clock.now_s()
    for k in range(1, 60):
        port.clock.sleep_until(start_s + k * 0.04)
        expected = 2048 + trapezoid(k * 0.04, TRAVEL, speed, acceleration)
        target = servo.shaft.tick_at(servo.motor.reference_rad)
        assert target == pytest.approx(expected, abs=0.01 * TRAVEL), k


def lag_at(port, velocity, **gains):
    """Return by how many ticks an XL430 trails its trajectory at a profile velocity."""
    servo = port.line.servos[1]
    for name, value in gains.items():
        servo.write(name, value)
    servo.write("torque_enable", 1)
    servo.write("profile_velocity", velocity)
    servo.write("goal_position", 4000)
    port.clock.sleep_until(port.clock.now_s() + 0.6)
    return servo.read("position_trajectory") - servo.read("present_position")


def test_xl430_lags_profile_by_69_ticks_at_velocity_100(make_port):
    assert lag_at(make_port("XL430-W250"), 100) == pytest.approx(69, abs=14)


def test_velocity_feed_forward_reduces_lag_by_register_value(make_port):
    without = lag_at(make_port("XL430-W250"), 100)
    some = lag_at(make_port("XL430-W250"), 100, feedforward_1st_gain=500)
    more = lag_at(make_port("XL430-W250"), 100, feedforward_1st_gain=1000)
    assert without - some == pytest.approx(some - more, abs=2)
    assert without - more > 10


@pytest.mark.parametrize(("model", "divisor"), [("XL330-M288", 256), ("XL430-W250", 128)])
def test_p_gain_is_scaled_by_divisor_of_servo_model(make_port, model, divisor):
    servo = make_port(model).line.servos[1]
    servo.write("position_p_gain", 640)
    assert servo.drive.kp == pytest.approx(640 / divisor * (4096 / (2 * math.pi)) / 885)


@pytest.mark.parametrize("model", ["SCS0009", "AX-12A"])
def test_servo_with_acceleration_zero_moves_at_goal_speed(make_port, model):
    port = make_port(model)
    servo = port.line.servos[1]
    name, value, ticks_s = {
        "SCS0009": ("goal_speed", 200, 200),
        "AX-12A": ("moving_speed", 200, 200 * 0.111 * 6 / (300 / 1024)),
    }[model]
    servo.write("torque_enable", 1)
    servo.write(name, value)
    servo.write("goal_position", 1000)
    port.clock.sleep_until(0.3)
    first = servo.read("present_position")
    port.clock.sleep_until(0.8)
    gone = servo.read("present_position") - first
    assert gone == pytest.approx(0.5 * ticks_s, abs=0.01 * 500)


def test_present_speed_equals_derivative_of_position(make_port):
    port = make_port("STS3215")
    servo = port.line.servos[1]
    servo.write("torque_enable", 1)
    servo.write("goal_speed", 600)
    servo.write("goal_position", 3500)
    port.clock.sleep_until(1.0)
    before, speeds = servo.read("present_position"), list[int]()
    for k in range(50):  # a shaft that sticks and slips is not always as fast
        port.clock.sleep_until(1.0 + 0.01 * (k + 1))
        speeds.append(servo.read("present_speed"))
    gone = servo.read("present_position") - before
    assert gone / 0.5 == pytest.approx(sum(speeds) / len(speeds), rel=0.03)


@pytest.mark.parametrize(("threshold", "moving"), [(50, 1), (150, 0)])
def test_moving_flag_is_set_above_moving_threshold(make_port, threshold, moving):
    port = make_port("STS3215")
    servo = port.line.servos[1]
    servo.write("moving_threshold", threshold)
    servo.write("operating_mode", 1)
    servo.write("torque_enable", 1)
    servo.write("goal_speed", 100)
    port.clock.sleep_until(1.0)
    assert servo.read("present_speed") == pytest.approx(100, abs=20)
    assert servo.read("moving") == moving


def test_overload_shuts_blocked_xm430_down_after_2_s(make_port):
    port = make_port("XM430-W350")
    servo = port.line.servos[1]
    servo.motor.stuck = True
    servo.write("torque_enable", 1)
    servo.write("goal_position", 4000)
    port.clock.sleep_until(1.9)
    before = servo.read("hardware_error_status")
    port.clock.sleep_until(2.2)
    after = servo.read("hardware_error_status"), servo.read("torque_enable")
    assert (before, after) == (0, (0x20, 0))
