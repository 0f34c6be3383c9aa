"""Limits of a motor: duty, current, voltage, friction, stops, backlash."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from servosim.control import ControlMode, DriveCommand
from servosim.motor import Motor
from servosim.parameters import PARAMETERS

DT_S = 0.001
MODELS = sorted(PARAMETERS)


def run(
    motor: Motor, drive: DriveCommand, seconds: float, load_nm: float = 0.0, volts: float = 0.0
) -> None:
    for _ in range(round(seconds / DT_S)):
        motor.step(DT_S, load_nm, drive, volts or motor.parameters.nominal_v)


def pwm(duty: float) -> DriveCommand:
    return DriveCommand(True, mode=ControlMode.PWM, goal_pwm=duty)


def blocked(model: str) -> Motor:
    motor = Motor(PARAMETERS[model])
    motor.stuck = True
    return motor


@pytest.mark.parametrize("model", MODELS)
def test_free_shaft_runs_at_no_load_speed_of_parameters(model: str) -> None:
    motor = Motor(PARAMETERS[model])
    run(motor, pwm(1.0), 3.0)
    assert motor.velocity_rad_s == pytest.approx(motor.parameters.no_load_speed_rad_s, rel=0.01)


@pytest.mark.parametrize(
    ("model", "rpm"),
    [("STS3215", 51.8), ("STS3215-C018", 45.0), ("STS3250", 75.0), ("XL330-M288", 122.0),
     ("XL330-M077", 383.0), ("XL430-W250", 61.0), ("XM430-W350", 46.0), ("AX-12A", 59.0)],
)  # fmt: skip
def test_no_load_speed_is_within_12_percent_of_data_sheet(model: str, rpm: float) -> None:
    speed_rad_s = PARAMETERS[model].no_load_speed_rad_s
    assert speed_rad_s == pytest.approx(rpm * 2.0 * math.pi / 60.0, rel=0.12)


@pytest.mark.parametrize("model", MODELS)
def test_blocked_shaft_gives_stall_torque_and_current(model: str) -> None:
    motor = blocked(model)
    run(motor, pwm(-1.0), 0.1)
    assert motor.torque_nm == pytest.approx(-motor.parameters.stall_torque_nm)
    assert motor.current_a == pytest.approx(-motor.parameters.stall_current_a)


def test_half_voltage_halves_blocked_torque() -> None:
    motor = blocked("XM430-W350")
    run(motor, pwm(1.0), 0.1, volts=6.0)
    assert motor.torque_nm == pytest.approx(motor.parameters.stall_torque_nm / 2.0)


def test_lower_voltage_makes_free_shaft_slower() -> None:
    fast, slow = Motor(PARAMETERS["XL330-M288"]), Motor(PARAMETERS["XL330-M288"])
    run(fast, pwm(1.0), 2.0, volts=5.0)
    run(slow, pwm(1.0), 2.0, volts=3.7)
    assert slow.velocity_rad_s == pytest.approx(fast.velocity_rad_s * 76 / 103, rel=0.05)


def test_motor_without_voltage_has_no_torque_and_no_current() -> None:
    motor = Motor(PARAMETERS["STS3215"])
    motor.step(DT_S, 0.0, DriveCommand(True, goal_rad=1.0), 0.0)
    assert (motor.torque_nm, motor.current_a, motor.pwm) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("limit", ["torque_limit", "pwm_limit"])
def test_duty_limit_reduces_stall_torque(limit: str) -> None:
    motor, drive = blocked("STS3215"), DriveCommand(True, goal_rad=1.0)
    setattr(drive, limit, 0.2)
    run(motor, drive, 0.1)
    assert motor.pwm == pytest.approx(0.2)
    assert motor.torque_nm == pytest.approx(0.2 * motor.parameters.duty_torque_nm)


def test_current_limit_applies_in_position_mode() -> None:
    motor = blocked("XM430-W350")
    run(motor, DriveCommand(True, goal_rad=1.0, current_limit_a=0.5), 0.1)
    assert motor.current_a == pytest.approx(0.5)


def test_current_mode_holds_its_current_at_any_speed() -> None:
    motor = Motor(PARAMETERS["XM430-W350"])
    drive = DriveCommand(True, mode=ControlMode.CURRENT, goal_current_a=0.3)
    for _ in range(30):
        motor.step(DT_S, 0.0, drive, 12.0)
        assert motor.current_a == pytest.approx(0.3)
    assert motor.velocity_rad_s > 1.0


def test_current_mode_with_zero_current_lets_shaft_turn_freely() -> None:
    motor = Motor(PARAMETERS["XM430-W350"])
    run(motor, DriveCommand(True, mode=ControlMode.CURRENT), 0.5, load_nm=0.5)
    assert motor.position_rad > 0.1


def test_current_based_position_mode_limits_current() -> None:
    motor = blocked("XM430-W350")
    drive = DriveCommand(True, mode=ControlMode.CURRENT_POSITION, goal_rad=1.0, goal_current_a=0.4)
    run(motor, drive, 0.1)
    assert motor.current_a == pytest.approx(0.4)


def test_current_under_load_is_torque_over_torque_constant() -> None:
    motor = Motor(PARAMETERS["STS3215"])
    run(motor, DriveCommand(True), 2.0, load_nm=-1.0)
    assert motor.torque_nm > 0.5
    assert motor.current_a == pytest.approx(motor.torque_nm / motor.parameters.torque_constant_nm_a)


@pytest.mark.parametrize("model", ["STS3215", "XL330-M288"])
def test_load_below_static_friction_does_not_move_free_shaft(model: str) -> None:
    motor = Motor(PARAMETERS[model])
    run(motor, DriveCommand(), 1.0, load_nm=0.95 * motor.parameters.static_friction_nm)
    assert abs(motor.position_rad) <= motor.parameters.backlash_rad / 2.0 + 1e-4


@pytest.mark.parametrize("model", ["STS3215", "XL330-M288"])
def test_load_above_static_friction_turns_free_shaft(model: str) -> None:
    motor = Motor(PARAMETERS[model])
    run(motor, DriveCommand(), 1.0, load_nm=1.5 * motor.parameters.static_friction_nm)
    assert motor.position_rad > 0.1


@pytest.mark.parametrize(("load_nm", "lifts"), [(0.34, True), (0.37, False)])
def test_friction_grows_with_square_of_load(load_nm: float, lifts: bool) -> None:
    others = ("friction_nm", "stribeck_nm", "load_friction", "load_stribeck", "backlash_rad")
    only_square = dict.fromkeys(others, 0.0) | {"load_square_per_nm": 0.2}
    motor = Motor(replace(PARAMETERS["STS3215"], **only_square))
    duty = 0.5 / motor.parameters.duty_torque_nm
    run(motor, pwm(duty), 0.5, load_nm=-load_nm)  # of 0.5 N m, 0.2 (0.5 + 0.354)^2 is lost
    assert (motor.position_rad > 0.001) is lifts


def test_free_shaft_coasts_to_rest() -> None:
    motor = Motor(PARAMETERS["STS3215"])
    run(motor, pwm(0.5), 0.5)
    run(motor, DriveCommand(), 3.0)
    rest_rad = motor.position_rad
    run(motor, DriveCommand(), 1.0)
    assert (motor.velocity_rad_s, motor.position_rad) == (0.0, rest_rad)


def test_shorted_motor_stops_sooner_than_open_circuit_motor() -> None:
    free, shorted = Motor(PARAMETERS["STS3215"]), Motor(PARAMETERS["STS3215"])
    for motor, drive in ((free, DriveCommand()), (shorted, pwm(0.0))):
        run(motor, pwm(0.5), 0.5)
        motor.place(0.0)
        motor.set_state(0.0, 2.0)
        run(motor, drive, 2.0)
    assert shorted.position_rad < 0.5 * free.position_rad


def test_mechanical_end_stop_withstands_full_torque() -> None:
    motor = Motor(PARAMETERS["STS3215"], upper_stop_rad=0.3)
    run(motor, pwm(1.0), 1.0)
    assert motor.position_rad == 0.3
    assert motor.velocity_rad_s == 0.0
    assert motor.torque_nm == pytest.approx(motor.parameters.stall_torque_nm)


def test_motor_can_drive_shaft_off_its_end_stop() -> None:
    motor = Motor(PARAMETERS["STS3215"], lower_stop_rad=-0.3)
    run(motor, pwm(-1.0), 1.0)
    run(motor, DriveCommand(True, goal_rad=0.2), 1.0)
    assert motor.position_rad == pytest.approx(0.2, abs=0.02)


def test_reversed_load_moves_joint_by_backlash() -> None:
    motor = Motor(PARAMETERS["STS3215"])
    load_nm = 0.5 * motor.parameters.static_friction_nm
    run(motor, DriveCommand(), 2.0, load_nm)
    high_rad = motor.position_rad
    run(motor, DriveCommand(), 2.0, -load_nm)
    assert high_rad - motor.position_rad == pytest.approx(motor.parameters.backlash_rad)


def test_reversed_motor_crosses_backlash_before_joint_moves() -> None:
    motor = Motor(PARAMETERS["STS3215"])
    run(motor, pwm(0.1), 1.0)
    run(motor, DriveCommand(), 1.0)
    turned_rad = motor.position_rad
    motor.step(DT_S, 0.0, pwm(-0.2), 7.4)
    motor.step(DT_S, 0.0, pwm(-0.2), 7.4)
    assert motor.torque_nm < 0.0
    assert motor.position_rad == pytest.approx(turned_rad, abs=1e-12)


def test_stuck_joint_does_not_move_and_draws_stall_current() -> None:
    motor = blocked("STS3215")
    run(motor, DriveCommand(True, goal_rad=1.0), 0.2)
    assert motor.position_rad == 0.0
    assert motor.current_a == pytest.approx(motor.parameters.stall_current_a)


def test_slipping_gears_let_load_move_joint() -> None:
    motor = Motor(PARAMETERS["STS3215"])
    run(motor, DriveCommand(True), 1.0, load_nm=-0.5)
    held_rad = motor.position_rad
    motor.grip = 0.05
    run(motor, DriveCommand(True), 1.0, load_nm=-0.5)
    assert motor.position_rad < held_rad - 0.2


@pytest.mark.parametrize("model", ["STS3215", "XL330-M288", "XL430-W250", "XM430-W350"])
def test_blocked_motor_at_full_duty_exceeds_70_celsius(model: str) -> None:
    motor = blocked(model)
    for _ in range(3000):
        motor.step(0.1, 0.0, pwm(1.0), motor.parameters.nominal_v)
    assert motor.temperature_c > 70.0


def test_steady_temperature_is_thermal_resistance_times_power() -> None:
    motor = blocked("STS3215")
    for _ in range(60000):
        motor.step(0.1, 0.0, pwm(0.44), 7.4)
    power_w = motor.current_a**2 * motor.parameters.resistance_ohm
    assert motor.temperature_c == pytest.approx(25.0 + 10.0 * power_w, rel=1e-3)


def test_holding_half_rated_load_settles_at_40_to_60_celsius() -> None:
    """SO-ARM100 issue 134: 15 kg cm held for ten minutes, 48 °C and no more."""
    motor = Motor(PARAMETERS["STS3215-C018"])
    for _ in range(60000):
        motor.step(0.002, 0.0, DriveCommand(), 12.0)
        current_a = 1.47 / motor.parameters.torque_constant_nm_a
        motor.heat.step(0.05, current_a**2 * motor.parameters.resistance_ohm)
    assert 40.0 < motor.temperature_c < 60.0


def test_hot_servo_cools_down_to_room_temperature() -> None:
    motor = Motor(PARAMETERS["STS3215"], room_c=20.0)
    motor.heat.temperature_c = 70.0
    for _ in range(30000):
        motor.step(0.1, 0.0, DriveCommand(), 7.4)
    assert motor.temperature_c == pytest.approx(20.0, abs=0.1)


def test_backlash_and_friction_are_within_data_sheet_bounds() -> None:
    for parameters in PARAMETERS.values():
        assert parameters.backlash_rad <= math.radians(1.0)
        assert parameters.static_friction_nm < 0.09 * parameters.stall_torque_nm
