"""Joints that are coupled by the masses of an arm: velocities of all joints after a step."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from operator import mul
from types import MappingProxyType

import numpy as np

from servosim.joint import STEP_S, Hand, SimulatedJoint
from servosim.motor import JointStep, solve_velocity
from servosim.urdf import Matrix

MAX_SWEEPS = 30
NO_HANDS: Mapping[int, Hand] = MappingProxyType({})
EXACT_RAD_S = 2e-4  # the iteration ends when a sweep changes no velocity by more than this


class CoupledJoints:
    """Joints whose accelerations act on each other through a mass matrix.

    Each joint solves for its own velocity after the step, with dry friction, backlash and stops,
    and all damping taken implicitly, under the load of the others' accelerations; the solutions are
    repeated in turn until they agree (projected Gauss-Seidel, as for contacts with friction: Jean
    1999, "The non-smooth contact dynamics method"). The matrix is symmetric and positive definite,
    so the iteration converges. It begins with the accelerations of the previous step.

    Args:
        joints: The joints in the order of the mass matrix.
    """

    def __init__(self, joints: Sequence[SimulatedJoint]) -> None:
        self._joints = joints
        self._leads = [(joint, joint.servos[0], joint.servos[0].motor) for joint in joints]
        self.come_to_rest()
        self.set_mass_matrix([[0.0] * len(joints)] * len(joints))

    def set_mass_matrix(self, mass: Sequence[Sequence[float]]) -> None:
        """Set the mass matrix, without the motors [kg m², on sliding joints kg]."""
        slopes = [joint.m_per_rad for joint in self._joints]
        per_step = [slope / STEP_S for slope in slopes]
        self._mass = mass
        self._shares = [
            slope / len(j.servos) for slope, j in zip(slopes, self._joints, strict=True)
        ]
        self._pulls: list[list[float]] = []  # torque at a horn per velocity gain of the others
        for k, (row, share) in enumerate(zip(mass, self._shares, strict=True)):
            pull = [share * m * rate for m, rate in zip(row, per_step, strict=True)]
            for servo in self._joints[k].servos:
                servo.motor.load_inertia_kg_m2 = pull[k] * STEP_S
            pull[k] = 0.0
            self._pulls.append(pull)

    def mass_matrix(self) -> Matrix:
        """Compute the mass matrix (n, n), including the motors."""
        return np.array(self._mass) + np.diag([joint.armature for joint in self._joints])

    def felt_mass_matrix(self) -> Matrix:
        """Compute the mass matrix (n, n) without the rotors of joints inside their backlash."""
        return np.array(self._mass) + np.diag([joint.felt_armature for joint in self._joints])

    def come_to_rest(self) -> None:
        """Forget the accelerations after a joint was placed elsewhere."""
        self._gained_rad_s = [0.0] * len(self._joints)

    def step(self, loads: Sequence[float], hands: Mapping[int, Hand] = NO_HANDS) -> None:
        """Step all joints under external torques (forces) [N m or N] and hands, by joint."""
        loads_nm = list(map(mul, loads, self._shares))
        steps, speeds_rad_s, change_rad_s = self._begin_step(loads_nm, hands)
        for _ in range(MAX_SWEEPS):
            if change_rad_s < EXACT_RAD_S:
                break
            change_rad_s = self._sweep(loads_nm, steps, speeds_rad_s)
        for k, (joint, lead, motor) in enumerate(self._leads):
            after_rad_s = speeds_rad_s[k] + self._gained_rad_s[k]
            if len(joint.servos) == 1:
                motor.finish_step(STEP_S, lead.drive, after_rad_s)
            else:
                joint.finish_step(after_rad_s)

    def _begin_step(
        self, loads_nm: list[float], hands: Mapping[int, Hand]
    ) -> tuple[list[JointStep], list[float], float]:
        """Run all controllers and solve once; return steps, speeds before, and the largest change.

        The friction of loaded gears uses the load as known here: it stays the same while the
        velocities are solved.
        """
        gained_rad_s, change_rad_s = self._gained_rad_s, 0.0
        steps: list[JointStep] = []
        speeds_rad_s: list[float] = []
        for k, (joint, lead, motor) in enumerate(self._leads):
            if len(joint.servos) == 1:
                lead.time_s += STEP_S
                pressed_nm = motor.press(STEP_S, lead.drive, lead.supply_v)
            else:
                pressed_nm = joint.press()
            speed_rad_s = motor.velocity_rad_s
            felt_nm = loads_nm[k] - sum(map(mul, self._pulls[k], gained_rad_s))
            if k in hands:
                step, pull_nm = self._begin_held(k, pressed_nm, felt_nm, hands[k])
                loads_nm[k] += pull_nm
                felt_nm += pull_nm
            else:
                step = motor.begin_motion(STEP_S, pressed_nm, felt_nm)
            gain_rad_s = solve_velocity(step, felt_nm) - speed_rad_s
            moved_rad_s = gain_rad_s - gained_rad_s[k]
            if not -change_rad_s <= moved_rad_s <= change_rad_s:
                change_rad_s = abs(moved_rad_s)
            gained_rad_s[k] = gain_rad_s
            steps.append(step)
            speeds_rad_s.append(speed_rad_s)
        return steps, speeds_rad_s, change_rad_s

    def _begin_held(
        self, k: int, pressed_nm: float, felt_nm: float, hand: Hand
    ) -> tuple[JointStep, float]:
        """Compute the step of a joint that a hand holds, and the hand's torque on a horn at rest.

        The hand's damping is taken implicitly, because a joint is light inside its backlash, unless
        the hand is at its limit.
        """
        joint, _, motor = self._leads[k]
        share, slope = self._shares[k], joint.m_per_rad
        pull_nm = hand.resting * share
        if math.isfinite(pull_nm):  # otherwise the hand pushes with full force
            step = motor.begin_motion(
                STEP_S, pressed_nm, felt_nm + pull_nm, hand.damping * slope * share
            )
            after = solve_velocity(step, felt_nm + pull_nm) * slope
            if hand.force_at(after) == hand.resting - hand.damping * after:
                return step, pull_nm
        else:
            hand.force_at(0.0)
        pull_nm = hand.force * share
        return motor.begin_motion(STEP_S, pressed_nm, felt_nm + pull_nm), pull_nm

    def _sweep(
        self, loads_nm: list[float], steps: list[JointStep], speeds_rad_s: list[float]
    ) -> float:
        """Solve each joint with the accelerations of the others; return the largest change."""
        gained_rad_s, change_rad_s = self._gained_rad_s, 0.0
        for k, (step, pull) in enumerate(zip(steps, self._pulls, strict=True)):
            load_nm = loads_nm[k] - sum(map(mul, pull, gained_rad_s))
            gain_rad_s = solve_velocity(step, load_nm) - speeds_rad_s[k]
            moved_rad_s = gain_rad_s - gained_rad_s[k]
            if not -change_rad_s <= moved_rad_s <= change_rad_s:
                change_rad_s = abs(moved_rad_s)
            gained_rad_s[k] = gain_rad_s
        return change_rad_s
