"""Hand guiding: the arm carries its own weight and follows the user's hand.

Each servo stays in position mode: a goal that leads its joint by the sag under gravity makes the
servo hold with just the torque of gravity. Each joint has an anchor, which stays until the hand has
moved the joint by a small angle from it, and then follows at that distance. The torque is therefore
the torque of gravity plus at most the stiffness times that angle, and an arm that nobody touches
stays at rest.

Current or duty modes would need an EEPROM write on a Dynamixel, and the arm would fall if the
program were killed. In position mode it holds.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from ikservo.arm import Arm
from ikservo.control.feed_forward import FeedForward
from ikservo.control.loop import ControlCycle
from ikservo.errors import RefusedError
from ikservo.kinematics.arrays import Vector
from ikservo.motion import TrajectoryPoint
from ikservo.planning.context import ArmContext

ANCHOR_RAD = 0.01
"""Angle between horn and anchor from which the anchor follows: a few ticks above noise."""

# If gravity loads a joint less than its dry friction, its anchor follows so closely that friction
# alone holds it when the hand lets go, but not closer than noise: a rotor that springs back would
# throw the link across the backlash.
_UNLOADED, _NOISE_TICKS = 1.0, 2.0

_SPEED_CLASS = "fast"  # fastest speed class with which anchors follow the hand
_FADE_S = 0.5  # duration of the change from the present goals to goals that carry only gravity
_MAX_STEP_S = 0.02  # a late cycle counts as at most this long


class HandGuiding:
    """Endless trajectory of servo goals that carry the arm and follow its joints.

    The trajectory is evaluated once per control cycle, after the joints are measured.

    Args:
        context: The arm.
        feed_forward: The feed-forward from the masses and servos of the arm.
        goals: The present goals of the servos (n,), rad or m.
    """

    def __init__(self, context: ArmContext, feed_forward: FeedForward, goals: Vector) -> None:
        self._context, self._feed_forward = context, feed_forward
        self._moved_by_hand = context.servos.compensator.corrects
        maps = [driven.joint_map for driven in context.servos.driven_joints]
        horns = np.array([each.unit_per_horn_rad for each in maps])
        ticks = np.array([each.unit_per_tick for each in maps])
        self._tolerance, self._unloaded_tolerance = ANCHOR_RAD * horns, ANCHOR_RAD * horns
        columns = list(feed_forward.columns)
        self._unloaded_tolerance[columns] = np.clip(
            feed_forward.dry_lag, _NOISE_TICKS * ticks[columns], self._tolerance[columns]
        )
        self._speed = context.model.speed(_SPEED_CLASS).rad_s * horns
        self._goals = goals
        self._anchor = context.servos.measured
        self._begun_s = self._last_s = context.now_s()
        self._excess = goals - self._anchor - self._lead()
        self.duration_s = math.inf

    def state(self, time_s: float) -> TrajectoryPoint:
        """Compute the next goals (n,), at rest."""
        now_s = self._context.now_s()
        measured = self._context.servos.measured
        weight = np.full_like(measured, np.inf)
        weight[list(self._feed_forward.columns)] = self._feed_forward.weight(measured)
        tolerance = np.where(weight < _UNLOADED, self._unloaded_tolerance, self._tolerance)
        # The anchors move towards joints that deviate by more than the tolerance.
        target = np.clip(self._anchor, measured - tolerance, measured + tolerance)
        step = self._speed * min(now_s - self._last_s, _MAX_STEP_S)
        self._anchor = self._anchor + np.clip(target - self._anchor, -step, step)
        self._last_s = now_s
        left = max(1.0 - (now_s - self._begun_s) / _FADE_S, 0.0)
        goals = np.clip(self._anchor + self._lead() + left * self._excess, *self._context.limits())
        return TrajectoryPoint.at_rest(np.where(self._moved_by_hand, goals, self._goals))

    def _lead(self) -> Vector:
        """Compute the lead (n,) of goals ahead of the anchors that lets servos carry the links."""
        at_rest = TrajectoryPoint.at_rest(self._anchor)
        return self._feed_forward.offsets(at_rest, np.zeros_like(self._anchor))


def guide_by_hand(arm: Arm, until: Callable[[], bool]) -> dict[str, float]:
    """Carry the arm's weight while a hand moves the arm, which then holds.

    Args:
        arm: The arm; its torque is switched on. Its gripper holds.
        until: Called in every control cycle; returns True to end.

    Returns:
        The final positions, rad or m by joint.

    Raises:
        CalibrationError: The arm is not calibrated, so gravity is unknown.
        RefusedError: Gravity is unknown, because the arm file has no masses or the motor of a servo
            is unknown; or the hand moved faster than the arm may. The arm holds its position.
        StoppedError: The arm was stopped; it holds.
    """
    context, runner = arm.context, arm.runner
    context.require_zeros()
    _require_gravity(context)
    context.warm_up()
    guiding: list[HandGuiding] = []

    def make(goals: Vector) -> HandGuiding:
        guiding.append(HandGuiding(context, _require_gravity(context), goals))
        return guiding[-1]

    def look(cycle: ControlCycle) -> None:
        if until():
            guiding[-1].duration_s = cycle.time_s

    with runner.requested():
        runner.return_within_limits()
        measured = runner.run(make, look, _SPEED_CLASS, compensated=False)
    context.servos.set_reference(measured)
    return context.index.by_name(measured)


def _require_gravity(context: ArmContext) -> FeedForward:
    """Return the arm's feed-forward for the present gains."""
    found = context.servos.compensator.feed_forward
    if found is None:
        raise RefusedError(
            f"{context.model.name} has no masses in its URDF, so its weight is unknown.",
            "Teach it with torque off: leave out --float.",
        )
    for name, drive in zip(context.chain.names, found.parameters.drives, strict=True):
        if drive is None:
            model = context.model.joint(name).servo.model
            raise RefusedError(
                f"The motor of {name} ({model}) is unknown, so it cannot support the arm.",
                "Teach it with torque off: leave out --float.",
            )
    return found
