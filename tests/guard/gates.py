"""A gate of two joints and a bus that records every goal."""

import math

from ikservo.calibration import JointMap, Limits
from ikservo.guard import DrivenJoint, Gate

TICK = 2 * math.pi / 4096
CYCLE_S = 0.02


class ManualClock:
    time_s = 0.0

    def now_s(self):
        return self.time_s


class Recorder:
    def __init__(self):
        self.sent = []

    def __call__(self, goals):
        self.sent.append(dict(goals))


class NamedGate:
    """A gate whose commands have names, and the bus that gets what passes."""

    def __init__(self, limits, bus, clock):
        self.gate, self._bus = Gate(limits, clock), bus
        self._limits = {driven.joint: driven for driven in limits}

    def __getattr__(self, name):
        return getattr(self.gate, name)

    def _row(self, values, default=None):
        """Return the values in the order of the joints; those of unknown ones come last."""
        unknown = [value for name, value in values.items() if name not in self._limits]
        return [values.get(name, default) for name in self._limits] + unknown

    def _named(self, row):
        rows = zip(self._limits, row, strict=True)
        return {name: tick for name, tick in rows if tick is not None}

    def _write(self, passed):
        ids = {name: driven.servo_id for name, driven in self._limits.items()}
        self._bus({ids[name]: tick for name, tick in self._named(passed.ticks).items()})
        self.gate.commit(passed)

    def send(self, goals, now_s=None):
        self._write(self.gate.pass_goals(self._row(goals), now_s))

    def reset_goals(self, ticks):
        self._write(self.gate.pass_reset(self._row(ticks)))

    def hold(self, ticks):
        self._write(self.gate.pass_hold(self._row(ticks)))

    def update_measured(self, ticks, time_s):
        self.gate.update_measured(self._row(ticks), time_s)

    def set_speeds(self, speeds):
        own = {name: driven.speed for name, driven in self._limits.items()}
        self.gate.set_speeds(self._row({**own, **speeds}))

    def shorten_goals(self, goals, now_s):
        return self._named(self.gate.shorten_goals(self._row(goals), now_s))

    def check_range(self, goals, start):
        self.gate.check_range(self._row(goals), self._row(start, 0))

    def clamp(self, name, tick):
        return self.gate._joints[list(self._limits).index(name)].clamp(tick)

    @property
    def goals(self):
        return self._named(self.gate.goals)

    @property
    def measured_ticks(self):
        return self._named(self.gate.measured_ticks)


def make_limits(name="elbow", servo_id=3, *, low=1000, high=3000, speed_tick_s=10_000):
    joint_map = JointMap.revolute(name, servo_id, 1, 2048, 4096)
    limits = Limits.of(name, joint_map.position(low), joint_map.position(high), "hand sweep")
    return DrivenJoint(joint_map, limits, speed_tick_s * TICK)


def make_gate_at(tick, **kwargs):
    """Return a gate, its bus and its clock; both joints were measured 20 ms after the start."""
    bus, clock = Recorder(), ManualClock()
    gate = NamedGate([make_limits(**kwargs), make_limits("wrist", 4)], bus, clock)
    gate.reset_goals({"elbow": tick, "wrist": 2048})
    bus.sent.clear()
    clock.time_s = CYCLE_S
    gate.update_measured({"elbow": tick, "wrist": 2048}, CYCLE_S)
    return gate, bus, clock
