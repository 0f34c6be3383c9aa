"""Recordings of slow motion, computed from the motors' equations without a simulator."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ikservo.apps.lab.drive_fit import JointPrior
from ikservo.apps.lab.drive_recording import DriveRecording
from ikservo.model.servo_torque import find_servo_torque

DT_S, LEG_S, SUPPLY_V = 0.01, 2.0, 12.0


@dataclass(frozen=True)
class Drive:
    """True parameters of one joint's servo."""

    kt: float = 2.3
    ohm: float = 6.5
    viscous: float = 0.02
    coulomb: float = 0.05
    load: float = 0.1
    slow: float = 0.02
    slow_load: float = 0.1
    slow_rad_s: float = 0.5
    gain: float = 4.6  # duty per rad
    senses: bool = True
    rotor_kg_m2: float = 0.02

    @property
    def full_nm(self):
        return self.kt * SUPPLY_V / self.ohm

    def duty(self, speed, gravity_nm):
        """Return the duty of steady motion, by substitution into the motor's equations."""
        shaft = gravity_nm + 0.0 * speed
        fade, side = np.exp(-np.abs(speed) / self.slow_rad_s), np.sign(speed)
        for _ in range(300):
            gears = np.abs(shaft + gravity_nm)
            dry = self.coulomb + self.load * gears + fade * (self.slow + self.slow_load * gears)
            shaft = gravity_nm + side * dry + self.viscous * speed
        return (shaft + self.kt**2 / self.ohm * speed) / self.full_nm


def prior_of(drive=None):
    return JointPrior(find_servo_torque("XM430-W350", None), 1, SUPPLY_V)


def record(dynamics, drives, seed=0, legs=16, dead=(), d_gain_s=0.0):
    """Return the recording of an arm on straight paths between random postures.

    Args:
        dynamics: Dynamics with the true masses.
        drives: The drive of each joint.
        seed: Seed of the postures.
        legs: Number of paths.
        dead: Joints that do not move.
        d_gain_s: D gain for goals that come in steps: between two goals the D gain takes its duty
            for each rad/s, and the error falls.
    """
    random, chain = np.random.default_rng(seed), dynamics.chain
    lower, upper = np.maximum(chain.lower_rad, -1.2), np.minimum(chain.upper_rad, 1.2)
    ends = random.uniform(lower, upper, (legs + 1, chain.dof))
    ends[:, list(dead)] = 0.0
    fractions = np.arange(0.0, 1.0, DT_S / LEG_S)
    q = np.concatenate([a + fractions[:, None] * (b - a) for a, b in pairwise(ends)])
    speed = np.repeat(np.diff(ends, axis=0) / LEG_S, len(fractions), axis=0)
    gravity = dynamics.gravity_torques(q)
    duty = np.column_stack([d.duty(speed[:, j], gravity[:, j]) for j, d in enumerate(drives)])
    lead = duty / [d.gain for d in drives]
    age_s = random.uniform(-0.003, 0.003, q.shape) if d_gain_s else np.zeros(q.shape)
    lead = lead - age_s * speed
    duty = duty - (np.array([d.gain for d in drives]) * age_s + d_gain_s) * speed
    current = (duty * SUPPLY_V - speed * [d.kt for d in drives]) / [d.ohm for d in drives]
    current[:, [not d.senses for d in drives]] = np.nan
    return DriveRecording(
        time_s=np.arange(len(q)) * DT_S,
        leg=np.repeat(np.arange(legs), len(fractions)),
        speed=speed,
        goal=q + lead,
        position=q,
        duty=duty[..., None],
        current_a=current[..., None],
        voltage_v=np.full((*q.shape, 1), SUPPLY_V),
        goal_age_s=age_s,
    )


def swing(drive, backlash_rad, joints=2, swings=8, half_rad=0.07, rad_s=0.3, crossing_s=0.1):
    """Return the recording of one joint that swings to both sides of zero.

    After each reversal its motor crosses the backlash while the joint is still: it speeds up and
    brakes again, against its inertia.
    """
    rest, way = np.zeros(round(crossing_s / DT_S)), np.full(round(2 * half_rad / rad_s / DT_S), 1.0)
    way[[0, 1, 2, -3, -2, -1]] = 0.25, 0.5, 0.75, 0.75, 0.5, 0.25  # no rotor jumps to a speed
    side = np.tile(np.repeat([1.0, -1.0], len(rest) + len(way)), swings // 2)
    speed = np.tile(np.append(rest, way), swings) * side * 2 * half_rad / (way.sum() * DT_S)
    shape = np.minimum(np.arange(len(rest)), np.arange(len(rest))[::-1]) + 0.5
    crossing = np.tile(np.append(shape / shape.mean(), 0.0 * way), swings) * side
    alone_rad_s = crossing * backlash_rad / crossing_s
    motor = speed + alone_rad_s
    inertia_nm = drive.rotor_kg_m2 * np.gradient(motor, DT_S)
    current = (drive.coulomb * np.sign(motor) + inertia_nm) / drive.kt
    alone = np.eye(1, joints)
    moved = np.append(0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1]))) * DT_S
    position = (moved - half_rad)[:, None] * alone
    duty = ((drive.ohm * current + drive.kt * motor) / SUPPLY_V)[:, None] * alone
    return DriveRecording(
        time_s=np.arange(len(side)) * DT_S,
        leg=np.repeat(np.arange(swings), len(rest) + len(way)),
        speed=speed[:, None] * alone,
        goal=position,
        position=position.copy(),
        duty=duty[..., None],
        current_a=(current[:, None] * alone)[..., None],
        voltage_v=np.full((len(side), joints, 1), SUPPLY_V),
        goal_age_s=np.zeros((len(side), joints)),
    )
