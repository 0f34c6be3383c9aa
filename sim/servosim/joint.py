"""A joint, its transmission, and external forces on it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from statistics import fmean
from typing import Protocol

from servosim.motor import OUTPUT_INERTIA_KG_M2
from servosim.servo import Servo


class Transmission(Protocol):
    """Conversion between the angle of a horn [rad] and the coordinate of its joint [rad or m]."""

    @property
    def is_prismatic(self) -> bool:
        """Whether the joint is prismatic."""
        ...

    def position(self, horn_rad: float) -> float:
        """Return the joint position for a rotation of the horn from joint zero."""
        ...

    def horn_rad(self, position: float) -> float:
        """Return the rotation of the horn for a joint position."""
        ...

    def slope(self, horn_rad: float) -> float:
        """Return the joint motion per rotation of the horn at this position, rad or m per rad."""
        ...


@dataclass(frozen=True, slots=True)
class Ratio:
    """A horn on the joint itself, a gear, or a rack, with a constant ratio.

    Attributes:
        per_rad: Joint motion per radian of the horn, rad or m.
        is_prismatic: Whether the joint is prismatic.
    """

    per_rad: float = 1.0
    is_prismatic: bool = False

    def position(self, horn_rad: float) -> float:
        """Compute the joint position."""
        return horn_rad * self.per_rad

    def horn_rad(self, position: float) -> float:
        """Compute the rotation of the horn."""
        return position / self.per_rad

    def slope(self, horn_rad: float) -> float:
        """Return the ratio."""
        return self.per_rad


@dataclass(frozen=True, slots=True)
class CrankAndRod:
    """A crank that pushes a slider by a rod: `x = r cos φ + sqrt(l² - r² sin² φ)`.

    φ decreases from its angle at joint zero, so that a growing horn angle pushes outwards. Near its
    dead centres, the slider hardly moves.

    Attributes:
        radius_m: Distance from the horn's axis to the pin.
        rod_m: Distance from the pin to the slider; longer than the radius.
        zero_rad: φ at joint zero.
    """

    radius_m: float
    rod_m: float
    zero_rad: float

    @property
    def is_prismatic(self) -> bool:
        """Whether the joint is prismatic: always."""
        return True

    def position(self, horn_rad: float) -> float:
        """Compute the slider's position."""
        return self._slide_position(self.zero_rad - horn_rad) - self._slide_position(self.zero_rad)

    def horn_rad(self, position: float) -> float:
        """Compute the rotation of the horn; out of reach, of the nearest slider position."""
        x, r, rod = position + self._slide_position(self.zero_rad), self.radius_m, self.rod_m
        x = min(rod + r, max(rod - r, x))
        cosine = (x * x + r * r - rod * rod) / (2.0 * r * x)
        return self.zero_rad - math.acos(min(1.0, max(-1.0, cosine)))

    def slope(self, horn_rad: float) -> float:
        """Return metres per radian, at least a hundredth of the radius."""
        phi = self.zero_rad - horn_rad
        across, along = self.radius_m * math.sin(phi), self.radius_m * math.cos(phi)
        steep = across + across * along / math.sqrt(self.rod_m**2 - across**2)
        least = 0.01 * self.radius_m
        return math.copysign(max(abs(steep), least), steep)

    def _slide_position(self, phi: float) -> float:
        across = self.radius_m * math.sin(phi)
        return self.radius_m * math.cos(phi) + math.sqrt(self.rod_m**2 - across**2)


DIRECT = Ratio()
"""The transmission of a horn that is mounted on the joint itself."""


Path = Callable[[float], tuple[float, float]]  # seconds since the grasp -> position, velocity

HAND_SPEED = 1.0  # speed of a hand [rad/s]; a tenth of it in m/s on a prismatic joint
STIFFNESS_RAD_S = 150.0  # natural frequency of the grip; stable at steps of 2 ms


def hold(position: float) -> Path:
    """Return a path that stays at a position (rad, or m for a prismatic joint)."""
    return lambda _: (position, 0.0)


def push(direction: float) -> Path:
    """Return a path that pushes with full force in a direction, given by its sign."""
    return hold(math.copysign(math.inf, direction))


def glide(start: float, end: float, speed: float) -> Path:
    """Return a path from `start` to `end` at a constant speed, which then stays there."""
    duration_s = abs(end - start) / speed
    velocity = math.copysign(speed, end - start)

    def path(time_s: float) -> tuple[float, float]:
        if time_s >= duration_s:
            return end, 0.0
        return start + velocity * time_s, velocity

    return path


def sweep(start: float, lower: float, upper: float, speed: float) -> Path:
    """Return a path back and forth between two positions forever, upwards first."""
    span = upper - lower

    def path(time_s: float) -> tuple[float, float]:
        phase = (start - lower + speed * time_s) % (2.0 * span)
        if phase < span:
            return lower + phase, speed
        return upper - (phase - span), -speed

    return path


@dataclass(slots=True)
class Hand:
    """A grip on one joint: a critically damped spring that follows a path.

    Attributes:
        path: The path of the hand.
        limit: The maximum force: N m, or N on a prismatic joint.
        only: +1 or -1 for an obstacle that pushes only in that direction; 0 for a grip.
        force: The force in the last step; positive forward.
        time_s: Time since the grasp.
        resting: The force in the next step if the joint rests.
        damping: Decrease of that force per rad/s (m/s).
    """

    path: Path
    limit: float = 2.0
    only: int = 0
    force: float = field(default=0.0, init=False)
    time_s: float = field(default=0.0, init=False)
    resting: float = field(default=0.0, init=False)
    damping: float = field(default=0.0, init=False)

    def aim(self, dt_s: float, position: float, inertia: float) -> None:
        """Set spring and damping for the next `dt_s` seconds.

        Args:
            dt_s: Duration of the step [s].
            position: The joint position.
            inertia: The inertia of the joint with its motors.
        """
        self.time_s += dt_s
        goal, goal_velocity = self.path(self.time_s)
        self.damping = 2.0 * STIFFNESS_RAD_S * inertia
        if self.only and (goal - position) * self.only <= 0.0:
            self.damping = 0.0  # the joint has not reached the obstacle
        self.resting = 0.0
        if self.damping:
            speed = STIFFNESS_RAD_S / 2.0 * (goal - position) + goal_velocity
            self.resting = self.damping * speed

    def force_at(self, velocity: float) -> float:
        """Compute the hand's force on the joint at a velocity, and store it as `force`."""
        desired = self.resting - self.damping * velocity
        self.force = min(self.limit, max(-self.limit, desired))
        return self.force


STEP_S = 0.001


@dataclass(frozen=True, slots=True)
class SimulatedJoint:
    """A joint and its servos, the leading servo first.

    Positions are joint coordinates (rad or m), loads torques or forces (N m or N).

    Attributes:
        name: The joint's name in the body.
        servos: The servos; the others take over the state of the first one.
        transmission: Transmission between their horns and the joint.
    """

    name: str
    servos: tuple[Servo, ...]
    transmission: Transmission = DIRECT

    @property
    def is_prismatic(self) -> bool:
        """Whether the joint is prismatic."""
        return self.transmission.is_prismatic

    @property
    def m_per_rad(self) -> float:
        """Joint motion per radian of the horn at this position: 1 without a transmission."""
        if self.transmission is DIRECT:  # called for each servo in each step
            return 1.0
        return self.transmission.slope(self.servos[0].motor.position_rad)

    @property
    def position(self) -> float:
        """The joint coordinate."""
        horn_rad = self.servos[0].motor.position_rad
        return horn_rad if self.transmission is DIRECT else self.transmission.position(horn_rad)

    @property
    def velocity(self) -> float:
        """The joint velocity."""
        return self.servos[0].motor.velocity_rad_s * self.m_per_rad

    @property
    def armature(self) -> float:
        """The inertia of rotors and gears, as felt at the joint."""
        total = sum(servo.motor.parameters.armature_kg_m2 for servo in self.servos)
        return total / self.m_per_rad**2

    @property
    def felt_armature(self) -> float:
        """The inertia that the servos add to the joint; in the backlash, only their outputs do."""
        if self.servos[0].motor.is_on_flank:
            return self.armature
        return len(self.servos) * OUTPUT_INERTIA_KG_M2 / self.m_per_rad**2

    @property
    def is_free(self) -> bool:
        """Whether no servo holds the joint."""
        if len(self.servos) == 1:  # called very often while an arm moves
            return not self.servos[0].drive.torque_on
        return not any(servo.drive.torque_on for servo in self.servos)

    def place(self, position: float) -> None:
        """Set the joint's position, at rest."""
        for servo in self.servos:
            servo.motor.place(self.transmission.horn_rad(position))

    def press(self) -> float:
        """Begin a step: run the servos' controllers; return the mean torque on their shaft.

        Servos on one shaft turn as one. A stiff spring between the shafts would throw each of them
        across its backlash in every step, and the gears would carry no load.
        """
        for follower in self.servos[1:]:
            follower.motor.carried = True
        return fmean(servo.press(STEP_S) for servo in self.servos)

    def finish_step(self, after_rad_s: float) -> None:
        """Turn the servos, given the velocity of the leading shaft after the step."""
        for servo in self.servos:
            servo.motor.finish_step(STEP_S, servo.drive, after_rad_s)
        lead = self.servos[0].motor
        for follower in self.servos[1:]:
            follower.motor.set_state(
                lead.position_rad, lead.velocity_rad_s, lead.lash_rad, lead.rotor_rad_s
            )

    def drive_force(self) -> float:
        """Step the servos without moving the joint; return the force that they exert on it."""
        for servo in self.servos:
            servo.motor.carried = True
            servo.step(STEP_S, 0.0)
        pressed_nm = sum(servo.motor.torque_nm * servo.motor.grip for servo in self.servos)
        return pressed_nm / self.m_per_rad

    def set_state(
        self,
        position: float,
        velocity: float,
        lash: float | None = None,
        rotor_velocity: float | None = None,
    ) -> None:
        """Set the servos to a state of the joint.

        Args:
            position: The joint position.
            velocity: The joint velocity.
            lash: The distance to the middle of the backlash; None: unchanged.
            rotor_velocity: The velocity of the rotors, in the joint's unit; None: that of the
                joint.
        """
        horn_rad = self.transmission.horn_rad(position)
        slope = self.transmission.slope(horn_rad)
        for servo in self.servos:
            servo.motor.set_state(
                horn_rad,
                velocity / slope,
                None if lash is None else lash / slope,
                None if rotor_velocity is None else rotor_velocity / slope,
            )
