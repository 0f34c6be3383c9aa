"""Records when torque of simulated servos comes on, and how far their goals are."""

import itertools
from dataclasses import dataclass

# An arm that sinks moves on between the reading and the goal: wx250s by 3.1 ticks, vx300s by 2.4,
# so101 by 0.2.
FEW_TICKS = 4.0


@dataclass(frozen=True)
class Enabling:
    """Torque of a servo came on.

    Attributes:
        servo_id: The id of the servo.
        goal_ticks: Distance between the goal in force and the position, counts of its sensor.
        outside_ticks: Distance of the position outside its own limits: a limp arm may rest there,
            and no servo accepts such a goal.
    """

    servo_id: int
    goal_ticks: float
    outside_ticks: int

    @property
    def jumps(self):
        """Return whether the joint would move further than to the nearest allowed position."""
        return self.goal_ticks > self.outside_ticks + FEW_TICKS


class TorqueWatch:
    """Records each time that an instruction switches torque on in a simulated world."""

    def __init__(self):
        self.enablings = []

    def restart(self):
        """Forget what was recorded."""
        self.enablings.clear()

    def add_world(self, world):
        """Watch the servos of a world, which may have torque already."""
        for servo in world.servos:
            self._watch_servo(servo)

    def _watch_servo(self, servo):
        before, was_on = servo.changed, [servo.drive.torque_on]

        def look():
            now_on = servo.drive.torque_on
            if now_on and not was_on[0]:
                away_rad = servo.drive.goal_rad - servo.motor.encoder_rad
                away_ticks = abs(away_rad) / servo.shaft.rad_per_tick
                self.enablings.append(Enabling(servo.id, away_ticks, _outside_ticks(servo)))
            was_on[0] = now_on
            before()

        servo.changed = look


def _outside_ticks(servo):
    """Return how far a servo is from the nearest goal that it accepts."""
    at_tick = servo.read("present_position")
    return next(
        ticks
        for ticks in itertools.count()
        if servo.is_goal_allowed(at_tick - ticks) or servo.is_goal_allowed(at_tick + ticks)
    )
