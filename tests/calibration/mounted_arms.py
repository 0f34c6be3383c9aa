"""Simulated arms with random mounting of their servos, and an operator who moves them."""

import math
import random
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache

from ikservo.apps.calibrating.by_hand_procedure import CalibrationState
from ikservo.apps.calibrating.calibration_session import TorqueOffArm
from ikservo.arm.opening import servo_specs
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.port import Port
from ikservo.model import load_model as load_uncached_model
from servosim import SimulatedPort, read_arm_file
from servosim.assembly import make_arm_world
from servosim.joint import Hand, glide, hold, sweep
from servosim.line import Line, LineOptions
from servosim.world import World

load_model = cache(load_uncached_model)  # models are values, and there are hundreds of arms

STRENGTH = 60.0  # N m or N: enough to hold any arm
STOP_CLEARANCE = math.radians(6.0)  # smallest angle between the pose and an end stop


@dataclass
class MountedArm:
    """A simulated arm and its ground truth.

    Positions are rad or m by joint; ``held`` is the offset from the pose at which the operator
    held each joint.
    """

    name: str
    seed: int
    world: World
    port: SimulatedPort
    stops: dict = field(default_factory=dict)
    pose: str = "home"
    held: dict = field(default_factory=dict)

    @property
    def line(self):
        return self.port.line

    def joint(self, name):
        return self.world.joint(name)

    def true_position(self, name):
        return self.joint(name).position

    def direction(self, servo_id):
        """Return the sign of growing reported ticks in the joint's coordinate."""
        servo = self.line.servos[servo_id]
        return getattr(servo, "direction", servo.shaft.sign)

    def register(self, servo_id, name):
        return self.line.servos[servo_id].read(name)

    def eeprom_writes(self):
        return sum(servo.memory.eeprom_writes for servo in self.world.servos)

    def power_cycle(self):
        """Power all servos off and on; the operator still holds the joints."""
        for servo in self.world.servos:
            servo.power_up()

    def open_bus(self):
        """Return a new bus on the same servos, as a restarted program opens it."""
        self.port.is_open = True
        model = load_model(self.name)
        return ServoBus(Port(self.port, f"bench:{self.name}", model.baud_rate), servo_specs(model))

    @contextmanager
    def open_limp(self):
        """Yield the arm with its torque off, for a calibration."""
        with self.open_bus() as bus:
            bus.load_return_delays()
            yield TorqueOffArm(load_model(self.name), bus)


def make_mounted_arm(name, seed, *, gravity=False, **how):
    """Return an arm with random zeros within a revolution, signs, end stops and offsets.

    Args:
        name: The arm.
        seed: Seed of all random values.
        gravity: Whether the links have weight.
        how: ``pose``; ``zero`` and ``sign`` instead of random values, one sign for all or by joint;
            ``spoiled=False`` for servos with the registers of their arm file; ``specimen`` of
            servosim.
    """
    model = load_model(name)
    chance = random.Random(f"{model.name} {seed}")  # the same for an arm file in any folder
    arm = read_arm_file(model.path)
    entries = [_mount(entry, chance, how) for entry in arm.joints]
    arm = replace(arm, joints=tuple(entries))
    pose, specimen = how.get("pose", "home"), how.get("specimen")
    world = make_arm_world(arm, pose, seed, backlash_deg=0.5, specimen=specimen)
    if not gravity:
        world = World(world.joints)
    stops = {
        joint.name: _stop(world.joint(joint.name), joint, model, chance, how)
        for joint in model.joints
    }
    port = SimulatedPort(Line(world, arm.baud, LineOptions(seed=seed)), f"bench:{name}")
    return MountedArm(name, seed, world, port, stops, how.get("pose", "home"))


def _mount(entry, chance, how):
    sign = how.get("sign")
    sign = (sign[entry.name] if isinstance(sign, dict) else sign) or chance.choice([-1, 1])
    zero = how["zero"] if "zero" in how else chance.uniform(0, 4096)
    if len(entry.servos) > 1:  # two servos on one joint are mounted nearly alike
        zero = chance.uniform(1900, 2200)
    return replace(entry, servos=tuple(_servo(s, sign, zero, chance, how) for s in entry.servos))


def _servo(servo, sign, zero, chance, how):
    feetech = servo.model.startswith("STS")
    eeprom_values = dict(servo.eeprom)
    if feetech and how.get("spoiled", True):
        eeprom_values["homing_offset"] = chance.choice([0, 0, chance.randint(-2047, 2047)])
        eeprom_values["phase"] = chance.choice([12, 12, 28])  # bit 4: counts turns
        eeprom_values["cw_dead_zone"] = eeprom_values["ccw_dead_zone"] = chance.choice([1, 1, 16])
    if "secondary_id" in eeprom_values:
        zero += chance.randint(-40, 40)
    return replace(servo, sign=sign, zero_tick=zero, eeprom=eeprom_values)


def _stop(simulated, joint, model, chance, how):
    """Place the joint's end stops near the arm file's limits and outside the pose; return them."""
    unit = joint.joint_map.unit
    away = 0.002 if unit == "m" else math.radians(8.0)
    clearance = 0.001 if unit == "m" else STOP_CLEARANCE
    pose = model.pose(how.get("pose", "home"))[joint.name]
    low = min(joint.limits.lower.value + chance.uniform(-away, away), pose - clearance)
    high = max(joint.limits.upper.value + chance.uniform(-away, away), pose + clearance)
    if unit == "rad" and high - low > math.radians(350.0):
        if chance.random() < 0.5:
            low, high = -math.inf, math.inf
        else:
            middle = chance.uniform(-0.05, 0.05)
            low, high = middle - math.radians(173), middle + math.radians(173)
    for servo in simulated.servos:
        servo.motor.lower_stop_rad = low / simulated.m_per_rad
        servo.motor.upper_stop_rad = high / simulated.m_per_rad
    return low, high


class Operator:
    """Holds, moves and sweeps joints by hand."""

    def __init__(self, arm):
        self.arm, self.world = arm, arm.world

    def hold_all(self):
        for joint in self.world.joints:
            self.hold(joint.name)

    def hold(self, name):
        place = self.arm.true_position(name)
        self.world.grasp(name, Hand(hold(place), self._strength(name)))

    def move(self, name, distance):
        here = self.arm.true_position(name)
        speed = 1.5 * self.world.joint(name).m_per_rad
        self.world.grasp(name, Hand(glide(here, here + distance, speed), self._strength(name)))

    def sweep_all(self, names=None):
        for joint in self.world.joints:
            if names is None or joint.name in names:
                self.sweep(joint.name)

    def sweep(self, name):
        joint = self.world.joint(name)
        low, high = self.arm.stops[name]
        here, beyond = self.arm.true_position(name), math.radians(6.0) * joint.m_per_rad
        if math.isinf(low):
            low, high = here - math.radians(190), here + math.radians(190)
        path = sweep(here, low - beyond, high + beyond, 3.5 * joint.m_per_rad)
        self.world.grasp(name, Hand(path, self._strength(name)))

    def _strength(self, name):
        return STRENGTH / self.world.joint(name).m_per_rad


def read_until(limp_arm, state, done, longest_s=30.0):
    """Update the calibration from the servos until `done(state)`; time is virtual."""
    start_s = limp_arm.bus.clock.now_s()
    while not done(state):
        reading = limp_arm.read_ticks()
        if reading:
            state = state.update(*reading)
        assert limp_arm.bus.clock.now_s() - start_s < longest_s, "the condition was never met"
    return state


def accept_anchor_pose(limp_arm, arm, margin_rad):
    operator = Operator(arm)
    operator.hold_all()
    state = CalibrationState(limp_arm.make_subjects(arm.pose), margin_rad)
    state = read_until(limp_arm, state, lambda w: w.is_at_rest)
    pose = limp_arm.model.pose(arm.pose)
    arm.held = {name: arm.true_position(name) - position for name, position in pose.items()}
    return operator, state.accept()


def show_directions(limp_arm, operator, state):
    while state.current_joint:
        name, before = state.current_joint.name, current_request(state)
        distance = state.current_joint.free_direction * math.radians(25)
        if state.is_second_trial and not state.returned:
            distance = -distance
        operator.move(name, distance * operator.world.joint(name).m_per_rad)
        state = read_until(limp_arm, state, lambda w, before=before: current_request(w) != before)
        operator.hold(name)
    return state


def current_request(state):
    """Return the requested motion: the joint, and whether it is the second, and the return."""
    return (
        state.current_joint and state.current_joint.name,
        state.is_second_trial,
        state.returned,
    )


def sweep_joints(limp_arm, operator, state, duration_s=6.0):
    operator.sweep_all()
    end_s = limp_arm.bus.clock.now_s() + duration_s
    return read_until(limp_arm, state, lambda _: limp_arm.bus.clock.now_s() >= end_s)


def run_to_review(limp_arm, arm, margin_rad):
    """Run a calibration up to its review."""
    limp_arm.disable_torque()
    operator, state = accept_anchor_pose(limp_arm, arm, margin_rad)
    state = show_directions(limp_arm, operator, state)
    return sweep_joints(limp_arm, operator, state).accept()
