"""All servos and the body they move, stepped together through time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from servosim.body import Body, FreeBody
from servosim.hand import Hand
from servosim.servo import Servo
from servosim.supply import Supply

__all__ = ["Joint", "World"]

STEP_S = 0.001
GRAVITY_EVERY = 4  # steps between two looks at the arm's posture
SUPERVISE_EVERY = 10  # steps between two looks of the firmware at heat, load and watchdog
COUPLING = 0.05  # share of the stiffest spring that a step of STEP_S can carry
DOZE_EVERY = 20  # likewise while nothing moves
STILL_STEPS = 20  # steps without any motion after which the world may doze


@dataclass(frozen=True, slots=True)
class Joint:
    """A joint of the body and the servos that turn it, the leading one first.

    Attributes:
        name: The joint's name in the body.
        servos: Those that turn it; all but the first are tied to it by a stiff spring.
        m_per_rad: Metres of a prismatic joint for one radian of the servo; 1 for a revolute.
    """

    name: str
    servos: tuple[Servo, ...]
    m_per_rad: float = 1.0

    @property
    def position(self) -> float:
        """Joint coordinate [rad or m]."""
        return self.servos[0].motor.position_rad * self.m_per_rad

    @property
    def velocity(self) -> float:
        """Joint velocity [rad/s or m/s]."""
        return self.servos[0].motor.velocity_rad_s * self.m_per_rad


class World:
    """Servos, the body they move, the hands that hold it and the supplies that feed them.

    ``rails`` are the supplies by nominal voltage: a Koch arm has one of 12 V and one of 5 V.

    Nothing happens between two steps; ``advance_to`` makes as many as time asks for. A world in
    which nothing moves and nothing changes dozes: only heat and supervision go on.
    """

    def __init__(
        self,
        joints: Sequence[Joint],
        body: Body | None = None,
        rails: Mapping[float, Supply] | None = None,
    ) -> None:
        self.joints = tuple(joints)
        self.servos = tuple(servo for joint in joints for servo in joint.servos)
        self.body = body or FreeBody([joint.name for joint in joints])
        volts = {servo.motor.parameters.nominal_v for servo in self.servos}
        self.rails = dict(rails or {volt: Supply(volt) for volt in volts})
        self._fed = {
            volts: [s for s in self.servos if s.motor.parameters.nominal_v == volts]
            for volts in self.rails
        }
        self.hands: dict[str, Hand] = {}
        self.steps = 0
        self._still = self._unheated = 0
        self._positions: list[float] = []
        self._loads = [0.0] * len(self.joints)
        for servo in self.servos:
            servo.changed = self.wake

    @property
    def time_s(self) -> float:
        """Simulated time [s]."""
        return self.steps * STEP_S

    @property
    def dozing(self) -> bool:
        """Whether nothing moves and nothing is about to."""
        return self._still >= STILL_STEPS

    def advance_to(self, time_s: float) -> None:
        """Let time pass up to the last whole step before ``time_s``."""
        target = int(time_s / STEP_S + 1e-6)
        while self.steps < target:
            if self.dozing:
                self._doze(min(target - self.steps, DOZE_EVERY))
            else:
                self._step()

    def wake(self) -> None:
        """Something has changed: look again."""
        self._still = 0

    def place(self, name: str, position: float) -> None:
        """Put a joint somewhere, at rest, as a person would who carries the arm there."""
        for joint in self.joints:
            if joint.name == name:
                for servo in joint.servos:
                    servo.motor.place(position / joint.m_per_rad)
        self.wake()

    def grasp(self, name: str, hand: Hand) -> None:
        """Let a hand take a joint."""
        self.hands[name] = hand
        self.wake()

    def release(self, name: str) -> None:
        """Let go of a joint."""
        self.hands.pop(name, None)
        self.wake()

    def _step(self) -> None:
        if self.steps % GRAVITY_EVERY == 0:
            self._feel_gravity()
        for k, joint in enumerate(self.joints):
            load = self._loads[k]
            if joint.name in self.hands:
                load += self._press(joint)
            self._turn(joint, load * joint.m_per_rad)
        self.steps += 1
        if self.steps % SUPERVISE_EVERY == 0:
            self._supervise(STEP_S * SUPERVISE_EVERY)
        self._watch_for_rest()

    def _watch_for_rest(self) -> None:
        positions = [servo.motor.position_rad for servo in self.servos]
        moving = positions != self._positions or any(servo.restless for servo in self.servos)
        self._positions = positions
        self._still = 0 if moving or self.hands else self._still + 1

    def _turn(self, joint: Joint, load_nm: float) -> None:
        lead = joint.servos[0]
        share_nm = load_nm / len(joint.servos)
        if len(joint.servos) == 1:
            lead.step(STEP_S, share_nm)
            return
        for follower in joint.servos[1:]:
            pull_nm = _coupling_nm(lead, follower)
            follower.step(STEP_S, share_nm + pull_nm)
            share_nm -= pull_nm
        lead.step(STEP_S, share_nm)

    def _press(self, joint: Joint) -> float:
        inertia = sum(
            servo.motor.parameters.armature_kg_m2 + servo.motor.load_inertia_kg_m2
            for servo in joint.servos
        )
        inertia /= joint.m_per_rad**2
        return self.hands[joint.name].press(STEP_S, joint.position, joint.velocity, inertia)

    def _feel_gravity(self) -> None:
        positions = [joint.position for joint in self.joints]
        velocities = [joint.velocity for joint in self.joints]
        self._loads = self.body.load_nm(positions, velocities)
        if self.steps % (GRAVITY_EVERY * 10) == 0:
            for joint, inertia in zip(self.joints, self.body.inertia(positions), strict=True):
                for servo in joint.servos:
                    share = inertia * joint.m_per_rad**2 / len(joint.servos)
                    servo.motor.load_inertia_kg_m2 = share

    def _supervise(self, dt_s: float) -> None:
        for volts, supply in self.rails.items():
            voltage_v = supply.voltage_v(servo.motor for servo in self._fed[volts])
            for servo in self._fed[volts]:
                servo.supply_v = voltage_v
                servo.supervise(dt_s)

    def _doze(self, steps: int) -> None:
        """Pass time in which nothing turns; heat and supervision take it in larger portions."""
        self.steps += steps
        for servo in self.servos:
            servo.time_s += steps * STEP_S
        self._unheated += steps
        if self._unheated >= DOZE_EVERY:
            for servo in self.servos:
                servo.warm(self._unheated * STEP_S)
            self._supervise(self._unheated * STEP_S)
            self._unheated = 0


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
