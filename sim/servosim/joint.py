"""A joint of the body and the servos that turn it."""

from __future__ import annotations

from dataclasses import dataclass

from servosim.hand import Hand
from servosim.servo import Servo
from servosim.transmission import DIRECT, Transmission

__all__ = ["STEP_S", "Joint"]

STEP_S = 0.001
COUPLING = 0.05  # share of the stiffest spring that a step of STEP_S can carry


@dataclass(frozen=True, slots=True)
class Joint:
    """A joint and its servos, the leading one first.

    Positions are joint coordinates (rad or m), loads torques or forces (N m or N).

    Attributes:
        name: The joint's name in the body.
        servos: Those that turn it; all but the first are tied to it by a stiff spring.
        transmission: Between their horns and the joint.
    """

    name: str
    servos: tuple[Servo, ...]
    transmission: Transmission = DIRECT

    @property
    def slides(self) -> bool:
        """Whether it is prismatic."""
        return self.transmission.slides

    @property
    def m_per_rad(self) -> float:
        """Joint motion for one radian of the horn, where it stands: 1 without a transmission."""
        return self.transmission.slope(self.servos[0].motor.position_rad)

    @property
    def position(self) -> float:
        """Joint coordinate."""
        return self.transmission.position(self.servos[0].motor.position_rad)

    @property
    def velocity(self) -> float:
        """Joint velocity."""
        return self.servos[0].motor.velocity_rad_s * self.m_per_rad

    @property
    def inertia(self) -> float:
        """What a force on the joint has to move: rotors, gears and what hangs on them."""
        motors = [servo.motor for servo in self.servos]
        total = sum(m.parameters.armature_kg_m2 + m.load_inertia_kg_m2 for m in motors)
        return total / self.m_per_rad**2

    @property
    def free(self) -> bool:
        """Whether no servo holds it."""
        return not any(servo.drive.torque_on for servo in self.servos)

    def place(self, position: float) -> None:
        """Put the joint somewhere, at rest."""
        for servo in self.servos:
            servo.motor.place(self.transmission.turned_rad(position))

    def hang(self, inertia: float) -> None:
        """Hang a body of this inertia on the joint."""
        for servo in self.servos:
            servo.motor.load_inertia_kg_m2 = inertia * self.m_per_rad**2 / len(self.servos)

    def press(self, hand: Hand) -> float:
        """Return a hand's force on the joint."""
        return hand.press(STEP_S, self.position, self.velocity, self.inertia)

    def turn(self, load: float) -> None:
        """Let the servos turn for one step under an outer load, which they share."""
        lead = self.servos[0]
        if len(self.servos) == 1:
            lead.step(STEP_S, load * self.m_per_rad)
            return
        share_nm = load * self.m_per_rad / len(self.servos)
        for follower in self.servos[1:]:
            pull_nm = _coupling_nm(lead, follower)
            follower.step(STEP_S, share_nm + pull_nm)
            share_nm -= pull_nm
        lead.step(STEP_S, share_nm)

    def drive(self) -> float:
        """Let carried servos work for one step; return their force on the joint."""
        for servo in self.servos:
            servo.motor.carried = True
            servo.step(STEP_S, 0.0)
        pressed_nm = sum(servo.motor.torque_nm * servo.motor.grip for servo in self.servos)
        return pressed_nm / self.m_per_rad

    def carry(self, position: float, velocity: float) -> None:
        """Take the servos to where the joint turned out to be."""
        turned_rad = self.transmission.turned_rad(position)
        for servo in self.servos:
            servo.motor.carry(turned_rad, velocity / self.transmission.slope(turned_rad))


def _coupling_nm(lead: Servo, follower: Servo) -> float:
    """Torque of the spring between two servos of one joint, on the follower."""
    a, b = lead.motor, follower.motor
    inertia = min(
        a.parameters.armature_kg_m2 + a.load_inertia_kg_m2,
        b.parameters.armature_kg_m2 + b.load_inertia_kg_m2,
    )
    stiffness = COUPLING * inertia / STEP_S**2
    damping = 2.0 * COUPLING * inertia / STEP_S
    twist_rad, twist_rad_s = a.position_rad - b.position_rad, a.velocity_rad_s - b.velocity_rad_s
    return stiffness * twist_rad + damping * twist_rad_s
