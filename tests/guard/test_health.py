"""Servos are warned about, held or relaxed; a servo without numbers is held."""

import math
from dataclasses import replace

import pytest

from ikservo.errors import ExitCode, RefusedError, ServoAlarmError
from ikservo.guard import HealthLimits, HealthMonitor, ServoTelemetry
from ikservo.guard.servo_health import torque_lost_error
from ikservo.registers import Alarm

WELL = ServoTelemetry("elbow", 10.0, 35.0, 7.4, 20.0, True, True, frozenset())


def see(health=None, **changes):
    return (health or HealthMonitor(HealthLimits())).update(replace(WELL, **changes))


def test_healthy_servo_gives_no_warning():
    assert see() == ()


@pytest.mark.parametrize("celsius", [60.0, 64.0])
def test_servo_at_60_celsius_gives_a_warning(celsius):
    assert see(temperature_c=celsius) == (f"elbow is at {celsius:.0f} °C; motion stops at 65 °C.",)


def test_servo_below_60_celsius_gives_no_warning():
    assert see(temperature_c=59.9) == ()


@pytest.mark.parametrize(("celsius", "release"), [(65.0, False), (69.9, False), (70.0, True)])
def test_arm_holds_from_65_celsius_and_goes_limp_from_70(celsius, release):
    health = HealthMonitor(HealthLimits())
    with pytest.raises(ServoAlarmError, match=r"elbow is at \d\d °C \(limit 65 °C\)"):
        see(health, temperature_c=celsius)
    assert health.release is release


def test_health_monitor_remembers_overheating_after_cooling():
    health = HealthMonitor(HealthLimits())
    with pytest.raises(ServoAlarmError):
        see(health, temperature_c=71.0)
    see(health)
    assert health.release


def test_healthy_arm_is_not_switched_off():
    health = HealthMonitor(HealthLimits())
    see(health)
    assert health.release is False


def test_servo_health_error_has_alarm_exit_code_and_hint():
    with pytest.raises(ServoAlarmError) as caught:
        see(temperature_c=66.0)
    assert caught.value.exit_code == ExitCode.ALARM
    assert caught.value.hint == "Let it cool down: arm.relax()"


@pytest.mark.parametrize("volts", [6.0, 8.4])
def test_supply_voltage_at_servo_limits_is_accepted(volts):
    see(HealthMonitor(HealthLimits(), {"elbow": (6.0, 8.4)}), voltage_v=volts)


@pytest.mark.parametrize("volts", [5.9, 8.5])
def test_supply_voltage_outside_servo_limits_makes_arm_hold(volts):
    health = HealthMonitor(HealthLimits(), {"elbow": (6.0, 8.4)})
    with pytest.raises(
        ServoAlarmError, match=rf"supply voltage of {volts} V, outside 6\.0 to 8\.4 V"
    ):
        see(health, voltage_v=volts)


@pytest.mark.parametrize(("volts", "limits"), [(6.4, "6.5 to 8.0"), (8.1, "6.5 to 8.0")])
def test_arm_file_supply_limits_may_be_stricter_than_servo(volts, limits):
    health = HealthMonitor(HealthLimits(low_v=6.5, high_v=8.0), {"elbow": (6.0, 8.4)})
    with pytest.raises(ServoAlarmError, match=limits):
        see(health, voltage_v=volts)


def test_servo_without_known_limits_accepts_any_supply():
    see(voltage_v=0.0)
    with pytest.raises(ServoAlarmError, match="outside"):
        see(voltage_v=-0.1)
    see(HealthMonitor(HealthLimits(), {"wrist": (6.0, 8.4)}), voltage_v=12.0)


@pytest.mark.parametrize("name", ["temperature_c", "voltage_v", "load_percent"])
def test_telemetry_with_nan_makes_arm_hold(name):
    with pytest.raises(ServoAlarmError, match="elbow"):
        see(**{name: math.nan})


@pytest.mark.parametrize("load", [math.inf, -math.inf])
def test_telemetry_with_infinite_load_makes_arm_hold(load):
    with pytest.raises(ServoAlarmError, match="at inf % load"):
        see(load_percent=load)


@pytest.mark.parametrize("load", [90.1, -90.1])
def test_load_above_90_percent_for_3_s_is_overload(load):
    health = HealthMonitor(HealthLimits())
    see(health, time_s=10.0, load_percent=load)
    see(health, time_s=12.9, load_percent=load)
    with pytest.raises(ServoAlarmError, match=r"has been at 90 % load for 3\.0 s"):
        see(health, time_s=13.0, load_percent=load)


@pytest.mark.parametrize("relief", [90.0, -90.0, None])
def test_overload_time_restarts_when_load_drops(relief):
    health = HealthMonitor(HealthLimits())
    for time_s, load in ((10.0, 99.0), (12.0, relief), (12.1, 99.0), (15.0, 99.0)):
        see(health, time_s=time_s, load_percent=load)


def test_loads_of_different_joints_are_not_added():
    health = HealthMonitor(HealthLimits())
    see(health, time_s=10.0, load_percent=99.0)
    see(health, joint="wrist", time_s=13.5, load_percent=99.0)


def test_overload_time_is_counted_per_joint():
    health = HealthMonitor(HealthLimits())
    see(health, time_s=10.0, load_percent=99.0)
    see(health, joint="wrist", time_s=11.0)
    with pytest.raises(ServoAlarmError):
        see(health, time_s=13.5, load_percent=99.0)


@pytest.mark.parametrize(
    ("torque", "reset_marker", "words"),
    [(False, True, "torque is off"), (True, False, "settings lost"),
     (False, False, "torque is off")],
)  # fmt: skip
def test_servo_reset_makes_arm_hold(torque, reset_marker, words):
    with pytest.raises(ServoAlarmError, match=f"elbow was reset: {words}"):
        see(torque=torque, settings_intact=reset_marker)


def test_servo_alarm_lists_flags_reported_by_servo():
    with pytest.raises(ServoAlarmError, match=r"elbow reports an alarm: overload, too hot\."):
        see(alarms=frozenset({"too hot", "overload"}))


@pytest.mark.parametrize(
    ("alarm", "remedy"),
    [(Alarm.VOLTAGE, "Check the power supply"), (Alarm.OVERLOAD, "Remove the load"),
     (Alarm.HEAT, "Remove the load, or let the servo cool down")],
)  # fmt: skip
def test_servo_alarm_hint_matches_alarm(alarm, remedy):
    with pytest.raises(ServoAlarmError) as caught:
        see(alarms=frozenset({str(alarm)}))
    assert caught.value.hint.startswith(remedy)


def test_servo_alarm_lists_all_faults_and_hint_for_first():
    with pytest.raises(ServoAlarmError) as caught:
        see(torque=False, temperature_c=80.0)
    assert caught.value.message == ("elbow was reset: torque is off; is at 80 °C (limit 65 °C).")
    assert caught.value.hint.startswith("Its supply voltage may have dropped.")


@pytest.mark.parametrize("time_s", [10.0, 11.0])
def test_telemetry_is_valid_for_1_s(time_s):
    health = HealthMonitor(HealthLimits())
    see(health)
    health.check_telemetry_age(time_s)


@pytest.mark.parametrize("time_s", [11.1, math.nan])
def test_telemetry_older_than_1_s_is_refused(time_s):
    health = HealthMonitor(HealthLimits())
    see(health)
    with pytest.raises(
        RefusedError, match=r"No status \(temperature, voltage, load\) from elbow for (1\.1|nan) s"
    ):
        health.check_telemetry_age(time_s)


def test_telemetry_age_is_checked_for_every_servo():
    health = HealthMonitor(HealthLimits())
    see(health)
    see(health, joint="wrist", time_s=11.5)
    with pytest.raises(RefusedError, match="elbow"):
        health.check_telemetry_age(11.5)


def test_telemetry_age_is_checked_after_servo_alarm():
    health = HealthMonitor(HealthLimits())
    with pytest.raises(ServoAlarmError):
        see(health, torque=False)
    with pytest.raises(RefusedError, match="elbow"):
        health.check_telemetry_age(20.0)


def test_arm_file_health_limits_replace_defaults():
    health = HealthMonitor(
        HealthLimits(warn_c=40, hold_c=45, release_c=50, load_percent=10, load_s=1)
    )
    assert see(health, temperature_c=41.0) == ("elbow is at 41 °C; motion stops at 45 °C.",)
    with pytest.raises(ServoAlarmError, match="limit 45 °C"):
        see(health, temperature_c=50.0)
    assert health.release
    with pytest.raises(ServoAlarmError, match="at 20 % load"):
        see(health, time_s=11.0)


@pytest.mark.parametrize(("joints", "what"), [(["elbow"], "joint"), (["waist", "elbow"], "arm")])
def test_torque_loss_error_says_that_arm_fell(joints, what):
    assert torque_lost_error(joints).message.endswith(f"The {what} is limp and has fallen.")
