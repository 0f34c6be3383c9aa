"""Which registers of a Dynamixel X are measured, and what writes to the others set off."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from servosim.servos.dynamixel_x_orders import PWM_FULL, VELOCITY_RAD_S

if TYPE_CHECKING:
    from servosim.servos.dynamixel_x import DynamixelX

__all__ = ["measured", "set_off"]


def measured(servo: DynamixelX) -> dict[str, Callable[[], int]]:
    """Return how each measured register gets its number."""
    motor = servo.motor
    stall_nm, unit_a = motor.parameters.stall_torque_nm, servo.orders.current_unit_a

    def speed(velocity_rad_s: float) -> int:
        return round(servo.direction * velocity_rad_s / VELOCITY_RAD_S)

    return {
        "present_position": servo.present_tick,
        "present_velocity": lambda: speed(motor.velocity_rad_s),
        "present_pwm": lambda: round(servo.direction * motor.pwm * PWM_FULL),
        "present_current": lambda: round(servo.direction * motor.current_a / unit_a),
        "present_load": lambda: round(servo.direction * motor.torque_nm / stall_nm * 1000),
        "velocity_trajectory": lambda: speed(motor.reference_velocity_rad_s),
        "position_trajectory": servo.trajectory_tick,
        "present_input_voltage": lambda: round(servo.supply_v * 10),
        "present_temperature": lambda: int(motor.temperature_c),
        "realtime_tick": lambda: int((servo.time_s - servo.boot_s) * 1000) % 32768,
        "moving": lambda: int(motor.moving),
        "backup_ready": lambda: int(servo.backup.ready),
        "moving_status": servo.watch.moving_status,
    }


def set_off(servo: DynamixelX) -> dict[str, Callable[[], None]]:
    """Return what a write to each register sets off."""
    orders = servo.orders
    groups: dict[Callable[[], None], tuple[str, ...]] = {
        servo.set_mode: ("operating_mode",),
        servo.set_drive_mode: ("drive_mode",),
        servo.set_protocol: ("protocol_type",),
        servo.set_torque: ("torque_enable",),
        servo.set_position_goal: ("goal_position",),
        servo.watch.start_watchdog: ("bus_watchdog",),
        servo.renew_goals: ("pwm_limit", "homing_offset"),
        orders.set_goal: ("goal_pwm", "goal_current", "goal_velocity"),
        orders.note_profile: ("profile_velocity", "profile_acceleration", "velocity_limit"),
        orders.set_limits: ("moving_threshold", "current_limit"),
        orders.set_gains: (
            "position_p_gain", "position_i_gain", "position_d_gain",
            "velocity_p_gain", "velocity_i_gain",
        ),
    }  # fmt: skip
    return {name: effect for effect, names in groups.items() for name in names}
