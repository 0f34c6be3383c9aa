"""All servos and the body they move, stepped together through time."""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Protocol, runtime_checkable

from servosim.body import Body, FreeBody
from servosim.contact import Contacts
from servosim.errors import SimulatorError
from servosim.hand import HAND_SPEED, Hand, glide, hold
from servosim.joint import STEP_S, Joint
from servosim.servo import Servo
from servosim.supply import Supply
from servosim.tip import Tip

__all__ = ["Mover", "World"]

GRAVITY_EVERY = 4  # steps between two looks at the arm's posture
SUPERVISE_EVERY = 10  # steps between two looks of the firmware at heat, load and watchdog
DOZE_EVERY = 20  # likewise while nothing moves
STILL_STEPS = 20  # steps without any motion after which the world may doze
CREEP_RAD, CREEP_STEPS = 1e-4, 100  # likewise for a body with soft friction (MuJoCo)


@runtime_checkable
class Mover(Protocol):
    """A body that moves its joints itself, in one step for all of them (MuJoCo)."""

    names: tuple[str, ...]
    limits: tuple[tuple[float, float], ...]

    def place(self, positions: Sequence[float]) -> None:
        """Put the body somewhere, at rest."""
        ...

    def reflect(self, slopes: Sequence[float]) -> None:
        """Take over where the transmissions stand: joint motion for one radian of each horn."""
        ...

    def step(self, dt_s: float, torques: Sequence[float]) -> tuple[list[float], list[float]]:
        """Let time pass under the motors' torques; return positions and velocities."""
        ...


class World:
    """Servos, the body they move, the hands that hold it and the supplies that feed them.

    ``rails`` are the supplies by nominal voltage: a Koch arm has one of 12 V and one of 5 V.

    ``contacts`` carry what is limp: a servo that holds does not feel them, and while a hand leads
    the arm it is kept clear of what is around it.

    ``limits`` are the body's, by joint; ``tip`` is the arm's, None for servos without an arm.

    Nothing happens between two steps; ``advance_to`` makes as many as time asks for. A world in
    which nothing moves and nothing changes dozes: only heat and supervision go on.
    """

    def __init__(
        self,
        joints: Sequence[Joint],
        body: Body | Mover | None = None,
        rails: Mapping[float, Supply] | None = None,
        contacts: Contacts | None = None,
        tip: Tip | None = None,
    ) -> None:
        self.joints = tuple(joints)
        self.servos = tuple(servo for joint in joints for servo in joint.servos)
        self._mover = body if isinstance(body, Mover) else None
        free = FreeBody([joint.name for joint in joints])
        self.body: Body = free if body is None or isinstance(body, Mover) else body
        limits = (self._mover or self.body).limits
        self.limits = dict(zip((joint.name for joint in joints), limits, strict=True))
        volts = {servo.motor.parameters.nominal_v for servo in self.servos}
        self.rails = dict(rails or {volt: Supply(volt) for volt in volts})
        self._fed = {
            volts: [s for s in self.servos if s.motor.parameters.nominal_v == volts]
            for volts in self.rails
        }
        self._contacts = contacts
        self.tip = tip
        self.hands: dict[str, Hand] = {}
        self.steps = 0
        self._still = self._unheated = 0
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._order = itertools.count()
        self._positions: list[float] = []
        self._loads = [0.0] * len(self.joints)
        for servo in self.servos:
            servo.changed = self.wake
        if self._mover is not None:
            self._mover.place([joint.position for joint in self.joints])

    @property
    def time_s(self) -> float:
        """Simulated time [s]."""
        return self.steps * STEP_S

    @property
    def dozing(self) -> bool:
        """Whether nothing moves and nothing is about to."""
        return self._still >= (STILL_STEPS if self._mover is None else CREEP_STEPS)

    def advance_to(self, time_s: float) -> None:
        """Let time pass up to the last whole step before ``time_s``."""
        target = int(time_s / STEP_S + 1e-6)
        while self.steps < target:
            while self._events and self._events[0][0] <= self.time_s:
                heapq.heappop(self._events)[2]()
            if self.dozing:
                self._doze(min(target - self.steps, DOZE_EVERY, self._steps_to_event()))
            else:
                self._step()

    def at(self, time_s: float, do: Callable[[], None]) -> None:
        """Let something happen at a time, or with the next step when that has passed."""
        if time_s < math.inf:
            heapq.heappush(self._events, (time_s, next(self._order), do))

    def rails_of(self, servos: Sequence[Servo]) -> list[Supply]:
        """Return the supplies that feed these servos."""
        return [
            supply
            for volts, supply in self.rails.items()
            if any(servo in self._fed[volts] for servo in servos)
        ]

    def wake(self) -> None:
        """Something has changed: look again."""
        self._still = 0

    def place(self, name: str, position: float) -> None:
        """Put a joint somewhere, at rest, as a person would who carries the arm there."""
        self.joint(name).place(position)
        if self._mover is not None:
            self._mover.place([joint.position for joint in self.joints])
        self.wake()

    def joint(self, name: str) -> Joint:
        """Return a joint by its name.

        Raises:
            SimulatorError: No such joint.
        """
        for joint in self.joints:
            if joint.name == name:
                return joint
        known = ", ".join(joint.name for joint in self.joints)
        raise SimulatorError(f"no joint is named {name!r}; known: {known}")

    def grasp(self, name: str, hand: Hand) -> None:
        """Let a hand take a joint."""
        self.hands[self.joint(name).name] = hand
        self.wake()

    def lead_tip(
        self, point_m: Sequence[float], speed: float = HAND_SPEED, limit: float = 10.0
    ) -> None:
        """Let hands take the joints that move the tip and bring it to a point, all in one time.

        Args:
            point_m: In the base frame.
            speed: Of the fastest joint [rad/s]; a tenth of it in m/s on sliding joints.
            limit: The greatest force on each joint: N m, or N on a sliding joint.

        Raises:
            SimulatorError: The point is out of reach, or there is no tip.
        """
        if self.tip is None:
            raise SimulatorError("these servos have no arm with a tip")
        goals = self.tip.posture_at(point_m, [joint.position for joint in self.joints])
        led = [(self.joints[i], goals[i]) for i in self.tip.moved_by]
        ways = [abs(goal - j.position) * (10.0 if j.slides else 1.0) for j, goal in led]
        duration_s = max(ways) / speed
        for joint, goal in led:
            way = abs(goal - joint.position)
            path = glide(joint.position, goal, way / duration_s) if way else hold(goal)
            self.grasp(joint.name, Hand(path, limit=limit))

    def release(self, name: str) -> None:
        """Let go of a joint."""
        self.hands.pop(name, None)
        self.wake()

    def _step(self) -> None:
        if self._mover is None:
            self._turn_each()
        else:
            self._move_all(self._mover)
        self.steps += 1
        if self.steps % SUPERVISE_EVERY == 0:
            self._supervise(STEP_S * SUPERVISE_EVERY)
        self._watch_for_rest()

    def _watch_for_rest(self) -> None:
        positions = [servo.motor.position_rad for servo in self.servos]
        moving = self._apart(positions)
        if moving:
            self._positions = positions
        busy = moving or self.hands or any(servo.restless for servo in self.servos)
        self._still = 0 if busy else self._still + 1

    def _apart(self, positions: list[float]) -> bool:
        """Say whether the servos are elsewhere than when last seen to move."""
        if self._mover is None or not self._positions:
            return positions != self._positions
        ways = zip(positions, self._positions, strict=True)
        return any(abs(now - before) > CREEP_RAD for now, before in ways)

    def _turn_each(self) -> None:
        """Turn each joint for itself under gravity and the hands."""
        if self.steps % GRAVITY_EVERY == 0:
            self._feel_gravity()
        for joint, load in zip(self.joints, self._loads, strict=True):
            hand = self.hands.get(joint.name)
            joint.turn(load if hand is None else load + joint.press(hand))

    def _move_all(self, mover: Mover) -> None:
        """Let the body turn all joints at once under the motors and the hands."""
        forces = [joint.drive() for joint in self.joints]
        for k, joint in enumerate(self.joints):
            if joint.name in self.hands:
                forces[k] += joint.press(self.hands[joint.name])
        mover.reflect([joint.m_per_rad for joint in self.joints])
        positions, velocities = mover.step(STEP_S, forces)
        for joint, position, velocity in zip(self.joints, positions, velocities, strict=True):
            joint.carry(position, velocity)

    def _steps_to_event(self) -> int:
        rest_s = self._events[0][0] - self.time_s if self._events else math.inf
        return max(1, math.ceil(rest_s / STEP_S)) if rest_s < 1.0 else DOZE_EVERY

    def _feel_gravity(self) -> None:
        positions = [joint.position for joint in self.joints]
        velocities = [joint.velocity for joint in self.joints]
        self._loads = self.body.load_nm(positions, velocities)
        if self._contacts is not None and not self.hands and any(j.free for j in self.joints):
            self._feel_contacts(self._contacts, positions, velocities)
        if self.steps % (GRAVITY_EVERY * 10) == 0:
            for joint, inertia in zip(self.joints, self.body.inertia(positions), strict=True):
                joint.hang(inertia)

    def _feel_contacts(
        self, contacts: Contacts, positions: list[float], velocities: list[float]
    ) -> None:
        """Let limp joints lie on the table and on the arm's own links."""
        inertias = [joint.inertia if joint.free else math.inf for joint in self.joints]
        pushed = contacts.torques(positions, velocities, inertias, STEP_S * GRAVITY_EVERY)
        self._loads = [
            load + push if joint.free else load
            for joint, load, push in zip(self.joints, self._loads, pushed, strict=True)
        ]

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
