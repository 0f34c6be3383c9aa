"""Watches from outside when torque of simulated servos comes on, and how far their goals are."""

from dataclasses import dataclass

FEW_TICKS = 12.0  # an arm that sinks moves on between the reading and the goal


@dataclass(frozen=True)
class Enabling:
    """Torque of a servo came on.

    Attributes:
        servo_id: Its id.
        goal_ticks: How far the goal that it is driven to is from where it is, counts of its sensor.
    """

    servo_id: int
    goal_ticks: float


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
                self.enablings.append(Enabling(servo.id, away_ticks))
            was_on[0] = now_on
            before()

        servo.changed = look
