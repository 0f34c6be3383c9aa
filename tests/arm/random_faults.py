"""Random motions with faults, and conditions that must hold afterwards."""

import random
from dataclasses import dataclass

import numpy as np

import ikservo
from ikservo.errors import (
    BusError,
    NotSettledError,
    PortLostError,
    RefusedError,
    ServoAlarmError,
)
from servosim.faults import Fault
from tests.arm.audit import Auditor
from tests.arm.simulated import clock_of, line_of, registers, servo_group, true_joints

EXPECTED_ERRORS = (BusError, NotSettledError, PortLostError, RefusedError, ServoAlarmError)
SPEEDS = ("slow", "normal", "fast")


@dataclass
class Outcome:
    """Outcome of one motion.

    Attributes:
        state: The name of the error, or "reached" or "short".
        noticed_s: Time from the fault to the end of the motion.
        cycles_after: Control cycles after the fault in which goals were still sent.
        wrong: Faults that the audit found.
    """

    state: str
    noticed_s: float
    cycles_after: int
    wrong: list


def seeded(seed):
    return random.Random(seed)


def random_goals(arm, dice, speed=None):
    """Return random goals in the middle half of every joint's range, and a speed."""
    goals = {}
    for driven in servo_group(arm).driven_joints:
        low, high = driven.position_range
        goals[driven.joint] = low + (high - low) * dice.uniform(0.25, 0.75)
    return goals, speed or dice.choice(SPEEDS)


def move_with_fault(name, dice, fault=None, speed=None, hook=None):
    """Move an arm to random goals while a fault happens; return the outcome.

    Args:
        name: The arm.
        dice: Source of the goals, the speed and the time of the fault.
        fault: Keys of the ``Fault``; ``at_share`` is its time as a fraction of the motion.
        speed: slow, normal or fast; random if None.
        hook: Called with the open arm and its auditor before the motion, and after it.
    """
    port = f"sim:?seed={dice.randrange(1_000_000)}"  # another seed of the bus each time
    with ikservo.open_arm(name, port=port, collisions=False) as arm:
        arm.enable()
        goals, speed = random_goals(arm, dice, speed)
        line, auditor = line_of(arm), Auditor(arm)
        plan = arm.plan_joints(goals, speed=speed)
        fault = dict(fault or {})
        at_s = line.world.time_s + plan.duration_s * fault.pop("at_share", dice.random())
        if fault:
            line.faults.add(Fault(at_s=at_s, **fault))
        state, wrong = "short", []
        try:
            report = arm.move_joints(goals, speed=speed)
        except EXPECTED_ERRORS as error:
            state = type(error).__name__
        else:
            state = "reached" if report.reached else "short"
            wrong += _untrue(arm, report)
        ended_s = line.world.time_s
        later = _later(arm, auditor)
        cycles = len({goal.time_s for goal in auditor.goals_after(at_s + 0.002)})
        wrong += auditor.faults() + later
        if hook:
            wrong += hook(arm, auditor, at_s)
        return Outcome(state, ended_s - at_s, cycles, wrong)


def _untrue(arm, report):
    """Return the differences between a report and the servos' registers."""
    truth = true_joints(arm)
    return [
        f"{joint} is at {truth[joint]:.4f}, reported at {reported:.4f}"
        for joint, reported in report.measured_rad.items()
        if not np.isclose(truth[joint], reported, atol=0.004)
    ]


def _later(arm, auditor):
    """Wait one second; return the goals that were still sent in it."""
    clock = clock_of(arm)
    clock.sleep_until(clock.now_s() + 0.01)
    before = len(auditor.goals), len(auditor.torque)
    clock.sleep_until(clock.now_s() + 1.0)
    moved = (len(auditor.goals), len(auditor.torque)) != before
    return ["something was sent after the motion had ended"] if moved else []


def random_fault(dice, ids):
    """Return a random fault of servosim, with random attributes."""
    one = dice.choice(ids)
    share, some = dice.random(), dice.choice((None, one))
    window_s = dice.uniform(0.05, 1.0)
    faults = [
        {"kind": "silent", "id": some, "for_s": window_s},
        {"kind": "silent", "id": some, "probability": dice.uniform(0.01, 0.3)},
        {"kind": "late", "probability": dice.uniform(0, 0.1), "delay_s": dice.uniform(0.001, 0.2)},
        {"kind": "duplicated", "probability": dice.uniform(0.0, 0.1), "delay_s": 0.003},
        {"kind": "short", "id": some, "probability": 0.05, "bytes": dice.randrange(8)},
        {"kind": "truncated", "id": some, "probability": 0.05},
        {"kind": "flipped", "probability": 0.05, "bits": dice.randrange(1, 5)},
        {"kind": "checksum", "id": some, "probability": 0.05},
        {"kind": "garbage", "probability": 0.05, "bytes": dice.randrange(1, 9)},
        {"kind": "lost", "probability": dice.uniform(0.0, 0.2)},
        {"kind": "unplug", "for_s": window_s},
        {"kind": "brownout", "id": some, "for_s": window_s},
        {"kind": "reset", "id": one},
        {"kind": "alarm", "id": one, "bits": dice.choice((0x01, 0x04, 0x20)), "for_s": window_s},
        {"kind": "hot", "id": one, "celsius": dice.uniform(50, 90)},
        {"kind": "stuck", "id": one, "for_s": window_s},
        {"kind": "slipping", "id": one, "grip": dice.uniform(0.05, 0.6)},
        {"kind": "voltage", "volts": dice.uniform(3.0, 9.0), "for_s": window_s},
        {"kind": "torque_lost", "id": one},
    ]
    return {**dice.choice(faults), "at_share": share}


def servo_ids(name):
    return [joint.servo.id for joint in ikservo.load_model(name).joints]


def servos_without_torque(arm, _auditor, _at_s):
    """Return the servos that have lost their torque."""
    torque = registers(arm, "torque_enable")
    return [f"servo {i} has lost its torque" for i, on in torque.items() if not on]
