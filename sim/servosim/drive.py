"""What a servo's firmware asks of its motor, in SI units: mode, goals, gains, limits."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum


class Mode(Enum):
    """The quantity that the firmware's control loop holds."""

    POSITION = "position"
    VELOCITY = "velocity"
    PWM = "pwm"
    CURRENT = "current"
    CURRENT_POSITION = "current-based position"


@dataclass(slots=True)
class Drive:
    """The orders of a servo's memory in SI units; the servo sets the fields, the motor reads them.

    The position loop works as the datasheets draw it, on the bridge's duty (PWM, -1..1):
    `duty = kp e + ki ∫e dt + kd de/dt + feedforward`, with `e = reference - encoder` in radians.
    The stiffness at the output is therefore `kp` times the stall torque at the supply's voltage.

    The motor plans a new profile from the reference's present position and velocity whenever one
    of goal_rad, velocity_limit_rad_s, acceleration_rad_s2, profile_time_s, acceleration_time_s
    changes; a servo that takes new limits only with the next goal writes them together with it.

    Attributes:
        torque_on: False opens the bridge: the shaft can be turned by hand.
        mode: What is controlled.
        goal_rad: Goal of POSITION and CURRENT_POSITION.
        goal_velocity_rad_s: Goal of VELOCITY.
        goal_pwm: Goal of PWM, -1..1.
        goal_current_a: Goal of CURRENT; its size is the limit of CURRENT_POSITION.
        velocity_limit_rad_s: The profile's cruising speed; 0 = none.
        acceleration_rad_s2: The profile's acceleration, also of VELOCITY; 0 = at once.
        profile_time_s: Time-based profile: from start to rest; 0 = use the two limits above.
        acceleration_time_s: Time-based profile: each ramp, at most half of profile_time_s.
        kp: Position gain [1/rad].
        ki: Position gain [1/(rad s)].
        kd: Position gain [s/rad].
        integral_limit: Largest size of the integral's share of the duty, 0..1.
        velocity_kp: Velocity gain [s/rad].
        velocity_ki: Velocity gain [1/rad].
        feed_forward: Share of the duty that the profile needs by itself (the back-EMF of its
            velocity, the torque of its acceleration, friction) which the firmware adds, 0..1.
        dead_zone_rad: Errors up to this size count as none.
        minimum_pwm: Smallest duty for an error outside the dead zone ("punch", "startup force").
        torque_limit: Limit of the duty, 0..1 (Feetech's torque limit).
        pwm_limit: Limit of the duty, 0..1 (Dynamixel's PWM limit); the smaller of both binds.
        current_limit_a: Limit of the winding's current.
        moving_threshold_rad_s: Speed above which `Motor.moving` is true.
    """

    torque_on: bool = False
    mode: Mode = Mode.POSITION
    goal_rad: float = 0.0
    goal_velocity_rad_s: float = 0.0
    goal_pwm: float = 0.0
    goal_current_a: float = 0.0
    velocity_limit_rad_s: float = 0.0
    acceleration_rad_s2: float = 0.0
    profile_time_s: float = 0.0
    acceleration_time_s: float = 0.0
    kp: float = 5.3
    ki: float = 0.0
    kd: float = 0.0
    integral_limit: float = 1.0
    velocity_kp: float = 0.5
    velocity_ki: float = 5.0
    feed_forward: float = 1.0
    dead_zone_rad: float = 0.0
    minimum_pwm: float = 0.0
    torque_limit: float = 1.0
    pwm_limit: float = 1.0
    current_limit_a: float = math.inf
    moving_threshold_rad_s: float = 0.24
