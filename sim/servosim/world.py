"""The simulated world: servos, power supply, body and the scripted hand, stepped together."""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from servosim.contact import Contacts
from servosim.coupling import CoupledJoints
from servosim.dynamics import Dynamics, FreeBody, Tip
from servosim.errors import SimulatorError
from servosim.joint import HAND_SPEED, STEP_S, Hand, SimulatedJoint, glide, hold
from servosim.motor import Motor
from servosim.servo import Servo
from servosim.surroundings import Surroundings
from servosim.urdf import Matrix


@dataclass(slots=True)
class PowerSupply:
    """A supply behind a resistance (its own, the cable's and the connectors').

    Attributes:
        open_v: Voltage without load.
        resistance_ohm: Resistance from the source to the servos.
        standby_a: Current of the electronics of all servos together.
    """

    open_v: float
    resistance_ohm: float = 0.1
    standby_a: float = 0.0

    def voltage_v(self, motors: Iterable[Motor]) -> float:
        """Compute the voltage at the servos' plugs.

        A bridge draws the winding's current for its duty's fraction of the time; a motor that
        brakes feeds no current back (the servos have no such path).
        """
        drawn_a = self.standby_a + sum(max(0.0, m.current_a * m.pwm) for m in motors)
        return max(0.0, self.open_v - self.resistance_ohm * drawn_a)


LOAD_STEPS = 4  # steps between two updates of the arm's loads; 1 for a lone joint
MASS_STEPS = 16  # the same for its mass matrix
PROTECTION_STEPS = 10  # steps between two checks of temperature, load and watchdog by the firmware
IDLE_CHECK_STEPS = 20  # the same while nothing moves
AT_REST_STEPS = 20  # steps without any motion after which the world may be idle
MAX_REST_DRIFT_RAD, DRIFT_CHECK_STEPS = 1e-4, 100  # the same for a body with soft friction (MuJoCo)


@runtime_checkable
class ExternalDynamics(Protocol):
    """A body that moves its joints itself, in one step for all of them (MuJoCo)."""

    names: tuple[str, ...]
    limits: tuple[tuple[float, float], ...]

    @property
    def is_at_rest(self) -> bool:
        """Whether nothing moves except, perhaps, the joints."""
        ...

    def cube_poses(self) -> list[Matrix]:
        """Return the poses of the cubes (4, 4), base frame."""
        ...

    def place(self, positions: Sequence[float]) -> None:
        """Set the body's positions, at rest."""
        ...

    def set_transmission_slopes(self, slopes: Sequence[float]) -> None:
        """Set the slopes of the transmissions: joint motion per radian of each horn."""
        ...

    def step(
        self, dt_s: float, torques: Sequence[float], hands: Mapping[int, Hand]
    ) -> list[tuple[float, float, float, float]]:
        """Advance time under the motors' torques and hands, by joint.

        Returns:
            Position, velocity, lash and the rotors' velocity of each joint.
        """
        ...


class World:
    """Servos, the body they move, the hands that hold it and the supplies that feed them.

    ``rails`` are the supplies by nominal voltage: a Koch arm has one with 12 V and one with 5 V.

    ``contacts`` act on joints without torque: they do not move a servo that holds, and while a
    hand moves the arm the hand keeps it clear of its surroundings.

    ``limits`` are those of the body, by joint. ``tip`` is that of the arm; servos without an arm
    have neither ``tip`` nor ``surroundings`` (None). ``home`` is the posture in front of which a
    simulated camera stands; by default the first posture.

    Nothing happens between two steps; ``advance_to`` makes as many steps as needed. A world in
    which nothing moves or changes is idle: only temperature and protections are updated.
    """

    def __init__(
        self,
        joints: Sequence[SimulatedJoint],
        body: Dynamics | ExternalDynamics | None = None,
        rails: Mapping[float, PowerSupply] | None = None,
        contacts: Contacts | None = None,
        tip: Tip | None = None,
        surroundings: Surroundings | None = None,
        home: Sequence[float] | None = None,
    ) -> None:
        self.joints = tuple(joints)
        self.servos = tuple(servo for joint in joints for servo in joint.servos)
        self._motors = tuple(servo.motor for servo in self.servos)
        self._mover = body if isinstance(body, ExternalDynamics) else None
        free = FreeBody([joint.name for joint in joints])
        self.body: Dynamics = free if body is None or isinstance(body, ExternalDynamics) else body
        limits = (self._mover or self.body).limits
        self.limits = dict(zip((joint.name for joint in joints), limits, strict=True))
        volts = {servo.motor.parameters.nominal_v for servo in self.servos}
        self.rails = dict(rails or {volt: PowerSupply(volt) for volt in volts})
        self._fed = {
            volts: [s for s in self.servos if s.motor.parameters.nominal_v == volts]
            for volts in self.rails
        }
        self._contacts = contacts
        self.tip, self.surroundings = tip, surroundings
        self.hands: dict[str, Hand] = {}
        self.steps = 0
        self._still = self._unheated = 0
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._order = itertools.count()
        self._positions: list[float] = []
        self._loads = [0.0] * len(self.joints)
        self._coupled = CoupledJoints(self.joints)
        self._gripped = self._grip_inertias()
        self._load_steps = LOAD_STEPS if len(self.joints) > 1 else 1
        for servo in self.servos:
            servo.changed = self.leave_idle
        if self._mover is not None:
            self._mover.place([joint.position for joint in self.joints])
        self.placed = [joint.position for joint in self.joints]  # before the arm sank or was moved
        self.home = list(home or self.placed)

    @property
    def time_s(self) -> float:
        """The simulated time [s]."""
        return self.steps * STEP_S

    @property
    def is_idle(self) -> bool:
        """Whether nothing moves and nothing is about to move."""
        return self._still >= (AT_REST_STEPS if self._mover is None else DRIFT_CHECK_STEPS)

    def advance_to(self, time_s: float) -> None:
        """Advance time to the last full step before ``time_s``."""
        target = int(time_s / STEP_S + 1e-6)
        while self.steps < target:
            while self._events and self._events[0][0] <= self.time_s:
                heapq.heappop(self._events)[2]()
            if self.is_idle:
                self._advance_idle(
                    min(target - self.steps, IDLE_CHECK_STEPS, self._steps_to_event())
                )
            else:
                self._run_step()

    def schedule(self, time_s: float, do: Callable[[], None]) -> None:
        """Schedule a callback at a time, or with the next step if that has passed."""
        if time_s < math.inf:
            heapq.heappush(self._events, (time_s, next(self._order), do))

    def supplies_of(self, servos: Sequence[Servo]) -> list[PowerSupply]:
        """Return the supplies that feed these servos."""
        return [
            supply
            for volts, supply in self.rails.items()
            if any(servo in self._fed[volts] for servo in servos)
        ]

    def keep_torque_with_goals(self) -> None:
        """Keep goal positions from switching on the torque of a Feetech STS."""
        for servo in self.servos:
            servo.goal_enables_torque = False

    def leave_idle(self) -> None:
        """Leave the idle state after a change."""
        self._still = 0

    def place(self, name: str, position: float) -> None:
        """Set a joint's position, at rest."""
        self.joint(name).place(position)
        self._coupled.come_to_rest()
        if self._mover is not None:
            self._mover.place([joint.position for joint in self.joints])
        self.placed = [joint.position for joint in self.joints]
        self.leave_idle()

    def joint(self, name: str) -> SimulatedJoint:
        """Return a joint by its name.

        Raises:
            SimulatorError: There is no such joint.
        """
        for joint in self.joints:
            if joint.name == name:
                return joint
        known = ", ".join(joint.name for joint in self.joints)
        raise SimulatorError(f"no joint is named {name!r}; known: {known}")

    def cube_poses(self) -> list[Matrix]:
        """Return the poses (4, 4) of the cubes, base frame, in their order."""
        return [] if self._mover is None else self._mover.cube_poses()

    def grasp(self, name: str, hand: Hand) -> None:
        """Let a hand grasp a joint."""
        self.hands[self.joint(name).name] = hand
        self.leave_idle()

    def lead_tip(
        self, point_m: Sequence[float], speed: float = HAND_SPEED, limit: float = 10.0
    ) -> None:
        """Let hands grasp the joints that move the tip, and move it to a point simultaneously.

        Args:
            point_m: The point in the base frame.
            speed: The speed of the fastest joint [rad/s]; a tenth of it in m/s on sliding joints.
            limit: The largest force on each joint: N m, or N on a sliding joint.

        Raises:
            SimulatorError: The point is out of reach, or there is no tip.
        """
        if self.tip is None:
            raise SimulatorError("these servos have no arm with a tip")
        goals = self.tip.posture_at(point_m, [joint.position for joint in self.joints])
        led = [(self.joints[i], goals[i]) for i in self.tip.moved_by]
        distances = [abs(goal - j.position) * (10.0 if j.is_prismatic else 1.0) for j, goal in led]
        duration_s = max(distances) / speed
        for joint, goal in led:
            distance = abs(goal - joint.position)
            path = glide(joint.position, goal, distance / duration_s) if distance else hold(goal)
            self.grasp(joint.name, Hand(path, limit=limit))

    def release(self, name: str) -> None:
        """Release a joint."""
        self.hands.pop(name, None)
        self.leave_idle()

    def _run_step(self) -> None:
        if self._mover is None:
            self._step_joints()
        else:
            self._step_body(self._mover)
        self.steps += 1
        if self.steps % PROTECTION_STEPS == 0:
            self._run_protections(STEP_S * PROTECTION_STEPS)
        self._update_rest()

    def _update_rest(self) -> None:
        positions = [motor.position_rad for motor in self._motors]
        moving = self._has_moved(positions)
        if moving:
            self._positions = positions
        busy = moving or self.hands or any(servo.is_active for servo in self.servos)
        if self._mover is None:
            # A rotor that crosses the backlash turns while the output stands still.
            busy = busy or any(motor.rotor_rad_s for motor in self._motors)
        else:
            busy = busy or not self._mover.is_at_rest
        self._still = 0 if busy else self._still + 1

    def _has_moved(self, positions: list[float]) -> bool:
        """Check whether the servos have left their positions after the last motion."""
        if self._mover is None or not self._positions:
            return positions != self._positions
        paths = zip(positions, self._positions, strict=True)
        return any(abs(now - before) > MAX_REST_DRIFT_RAD for now, before in paths)

    def _step_joints(self) -> None:
        """Step all joints under the body's loads and the hands."""
        if self.steps % self._load_steps == 0:
            self._update_loads()
        if not self.hands:
            self._coupled.step(self._loads)
            return
        self._coupled.step(self._loads, self._aimed_hands(self._gripped))

    def _aimed_hands(self, inertias: Sequence[float]) -> dict[int, Hand]:
        """Return the hands by the index of their joint, prepared for the next step."""
        hands = dict[int, Hand]()
        for k, joint in enumerate(self.joints):
            if joint.name in self.hands:
                hand = hands[k] = self.hands[joint.name]
                hand.aim(STEP_S, joint.position, inertias[k])
        return hands

    def _step_body(self, mover: ExternalDynamics) -> None:
        """Step the body with all joints at once under the motors and the hands."""
        forces = [joint.drive_force() for joint in self.joints]
        hands = self._aimed_hands([joint.armature for joint in self.joints])
        mover.set_transmission_slopes([joint.m_per_rad for joint in self.joints])
        for joint, state in zip(self.joints, mover.step(STEP_S, forces, hands), strict=True):
            joint.set_state(*state)

    def _steps_to_event(self) -> int:
        rest_s = self._events[0][0] - self.time_s if self._events else math.inf
        return max(1, math.ceil(rest_s / STEP_S)) if rest_s < 1.0 else IDLE_CHECK_STEPS

    def _update_loads(self) -> None:
        """Update loads and masses for the next steps, at the posture in their middle.

        Loads at the present posture would lag, and would drive joints that swing.
        """
        positions = [joint.position for joint in self.joints]
        velocities = [joint.velocity for joint in self.joints]
        if self.steps % MASS_STEPS == 0:
            amidst = _advanced(positions, velocities, MASS_STEPS)
            self._coupled.set_mass_matrix(self.body.mass_matrix(amidst))
        amidst = _advanced(positions, velocities, self._load_steps)
        self._loads = self.body.load_nm(amidst, velocities)
        if self.hands:
            self._gripped = self._grip_inertias()
        elif self._contacts is not None and any(joint.is_free for joint in self.joints):
            self._update_contacts(self._contacts, positions, velocities)

    def _grip_inertias(self) -> list[float]:
        """Compute each joint's inertia while all others yield: the smallest that a hand feels."""
        return (1.0 / np.linalg.inv(self._coupled.mass_matrix()).diagonal()).tolist()

    def _update_contacts(
        self, contacts: Contacts, positions: list[float], velocities: list[float]
    ) -> None:
        """Apply contacts to joints without torque: the table and the arm's own links."""
        free = np.array([joint.is_free for joint in self.joints])
        interval_s = STEP_S * self._load_steps
        mass = self._coupled.felt_mass_matrix()
        self._loads = contacts.torques(positions, velocities, mass, free, self._loads, interval_s)

    def _run_protections(self, dt_s: float) -> None:
        for volts, supply in self.rails.items():
            voltage_v = supply.voltage_v(servo.motor for servo in self._fed[volts])
            for servo in self._fed[volts]:
                servo.supply_v = voltage_v
                servo.run_protections(dt_s)

    def _advance_idle(self, steps: int) -> None:
        """Advance time without motion; temperature and protections in larger steps."""
        self.steps += steps
        for servo in self.servos:
            servo.time_s += steps * STEP_S
        self._unheated += steps
        if self._unheated >= IDLE_CHECK_STEPS:
            for servo in self.servos:
                servo.advance_heating(self._unheated * STEP_S)
            self._run_protections(self._unheated * STEP_S)
            self._unheated = 0


def _advanced(positions: list[float], velocities: list[float], steps: int) -> list[float]:
    """Compute the mean of the positions at the beginnings of the next steps."""
    ahead_s = STEP_S * (steps - 1) / 2.0
    return [q + v * ahead_s for q, v in zip(positions, velocities, strict=True)]
