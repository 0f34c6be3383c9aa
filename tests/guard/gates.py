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


def make_limits(name="elbow", servo_id=3, *, low=1000, high=3000, speed_tick_s=10_000):
    joint_map = JointMap.revolute(name, servo_id, 1, 2048, 4096)
    limits = Limits.of(name, joint_map.position(low), joint_map.position(high), "hand sweep")
    return DrivenJoint(joint_map, limits, speed_tick_s * TICK)


def make_gate_at(tick, **kwargs):
    """Return a gate, its bus and its clock; both joints were measured 20 ms after the start."""
    bus, clock = Recorder(), ManualClock()
    gate = Gate([make_limits(**kwargs), make_limits("wrist", 4)], bus, clock)
    gate.reset_goals({"elbow": tick, "wrist": 2048})
    bus.sent.clear()
    clock.time_s = CYCLE_S
    gate.update_measured({"elbow": tick, "wrist": 2048}, CYCLE_S)
    return gate, bus, clock
