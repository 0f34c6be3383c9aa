"""Arms whose servos are mounted as nobody wrote down, and the hands of a person on them."""

import math
import random
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache

from ikservo.arm.opening import servo_specs
from ikservo.calibration.procedure import CalibrationState
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.port import Port
from ikservo.maintenance.calibration_session import TorqueOffArm
from ikservo.model import load_model as load_model_afresh
from servosim import SimulatedPort, read_arm_file
from servosim.assembly import make_arm_world
from servosim.joint import Hand, glide, hold, sweep
from servosim.line import Line, LineOptions
from servosim.world import World

load_model = cache(load_model_afresh)  # models are values, and there are hundreds of arms

STRENGTH = 60.0  # N m or N: these hands hold any arm
ROOM = math.radians(6.0)  # between the pose and a stop


@dataclass
class HiddenArm:
    """A simulated arm with its truth beside it.

    Positions are rad or m by joint; ``held`` is how far from the pose a joint really was held.
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
        """All servos lose their power and boot again; hands still hold the joints."""
        for servo in self.world.servos:
            servo.power_up()

    def open_bus(self):
        """Return a bus on the same servos, as a program that is started anew has it."""
        self.port.is_open = True
        model = load_model(self.name)
        return ServoBus(Port(self.port, f"desk:{self.name}", model.baud_rate), servo_specs(model))

    @contextmanager
    def loose(self):
        """Yield the arm as a calibration has it."""
        with self.open_bus() as bus:
            bus.load_return_delays()
            yield TorqueOffArm(load_model(self.name), bus)


def hidden_arm(name, seed, *, gravity=False, **how):
    """Return an arm with zeros anywhere in a turn, signs, stops and offsets by chance."""
    chance = random.Random(f"{name} {seed}")
    model = load_model(name)
    arm = read_arm_file(model.path)
    entries = [_mounted(entry, chance, how) for entry in arm.joints]
    arm = replace(arm, joints=tuple(entries))
    world = make_arm_world(arm, how.get("pose", "home"), seed)
    if not gravity:
        world = World(world.joints)
    stops = {
        joint.name: _stop(world.joint(joint.name), joint, model, chance, how)
        for joint in model.joints
    }
    for servo in world.servos:
        servo.motor._half_play_rad = math.radians(0.25)
    port = SimulatedPort(Line(world, arm.baud, LineOptions(seed=seed)), f"desk:{name}")
    return HiddenArm(name, seed, world, port, stops, how.get("pose", "home"))


def _mounted(entry, chance, how):
    sign = how.get("sign") or chance.choice([-1, 1])
    zero = how["zero"] if "zero" in how else chance.uniform(0, 4096)
    if len(entry.servos) > 1:  # two servos on one joint are put on with some care
        zero = chance.uniform(1900, 2200)
    return replace(entry, servos=tuple(_servo(s, sign, zero, chance, how) for s in entry.servos))


def _servo(servo, sign, zero, chance, how):
    feetech = servo.model.startswith("STS")
    delivered = dict(servo.eeprom)
    if feetech and how.get("spoiled", True):
        delivered["homing_offset"] = chance.choice([0, 0, chance.randint(-2047, 2047)])
        delivered["phase"] = chance.choice([12, 12, 28])  # bit 4: counts turns
        delivered["cw_dead_zone"] = delivered["ccw_dead_zone"] = chance.choice([1, 1, 16])
    if "secondary_id" in delivered:
        zero += chance.randint(-40, 40)
    return replace(servo, sign=sign, zero_tick=zero, eeprom=delivered)


def _stop(simulated, joint, model, chance, how):
    """Put the joint's true stops somewhere near the arm file's limits, outside the pose."""
    unit = joint.joint_map.unit
    away = 0.002 if unit == "m" else math.radians(8.0)
    room = 0.001 if unit == "m" else ROOM
    pose = model.pose(how.get("pose", "home"))[joint.name]
    low = min(joint.limits.lower.value + chance.uniform(-away, away), pose - room)
    high = max(joint.limits.upper.value + chance.uniform(-away, away), pose + room)
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


class Person:
    """Holds, moves and answers as a patient person would."""

    def __init__(self, arm):
        self.arm, self.world = arm, arm.world

    def hold_all(self):
        for joint in self.world.joints:
            self.hold(joint.name)

    def hold(self, name):
        place = self.arm.true_position(name)
        self.world.grasp(name, Hand(hold(place), self._strength(name)))

    def move(self, name, way):
        here = self.arm.true_position(name)
        speed = 1.5 * self.world.joint(name).m_per_rad
        self.world.grasp(name, Hand(glide(here, here + way, speed), self._strength(name)))

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


def read_until(loose, wizard, done, longest_s=30.0):
    """Read the servos until something holds; time is virtual."""
    start_s = loose.bus.clock.now_s()
    while not done(wizard):
        reading = loose.read_ticks()
        if reading:
            wizard = wizard.update(*reading)
        assert loose.bus.clock.now_s() - start_s < longest_s, "it never came to that"
    return wizard


def anchored(loose, arm, margin_rad):
    person = Person(arm)
    person.hold_all()
    wizard = CalibrationState.begin(loose.make_subjects(arm.pose), margin_rad)
    wizard = read_until(loose, wizard, lambda w: w.is_at_rest)
    pose = loose.model.pose(arm.pose)
    arm.held = {name: arm.true_position(name) - position for name, position in pose.items()}
    return person, wizard.accept()


def shown_directions(loose, person, wizard):
    while wizard.current_joint:
        subject = wizard.current_joint
        way = math.radians(25) * subject.free_direction * person.world.joint(subject.name).m_per_rad
        person.move(subject.name, -way if wizard.is_second_trial and not wizard.returned else way)
        before = stage_of(wizard)
        wizard = read_until(loose, wizard, lambda w, before=before: stage_of(w) != before)
        person.hold(subject.name)
    return wizard


def stage_of(wizard):
    """Return what is asked for: which joint, and its first motion, its way back or its second."""
    return (
        wizard.current_joint and wizard.current_joint.name,
        wizard.is_second_trial,
        wizard.returned,
    )


def swept(loose, person, wizard, duration_s=6.0):
    person.sweep_all()
    end_s = loose.bus.clock.now_s() + duration_s
    return read_until(loose, wizard, lambda _: loose.bus.clock.now_s() >= end_s)


def reviewed(loose, arm, margin_rad):
    """Go through the whole conversation up to the review."""
    loose.disable_torque()
    person, wizard = anchored(loose, arm, margin_rad)
    wizard = shown_directions(loose, person, wizard)
    return swept(loose, person, wizard).accept()
