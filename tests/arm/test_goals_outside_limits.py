"""No goal is further outside the limits than the joint was when its torque came on."""

from types import SimpleNamespace

import numpy as np
import pytest

import ikservo
from ikservo.control.servo_group import hold_ticks
from ikservo.errors import RefusedError
from ikservo.registers import RegisterName
from tests.arm.simulated import line_of, servo_group

BEYOND_RAD = 0.03
ARMS = ["so101", "koch", "open_manipulator_x", "px100", "wx250s", "vx300s"]


class GoalWitness:
    """Collects the goals that each servo accepts, by id."""

    def __init__(self, arm):
        self.goals = {}
        for servo in line_of(arm).world.servos:
            servo.on_write = lambda *_, servo=servo: self.look(servo)

    def look(self, servo):
        self.goals.setdefault(servo.id, set()).add(servo.read("goal_position"))


def excess_ticks(arm, ticks):
    """Return how far ticks, by servo id, are outside the limits, by joint."""
    found = {}
    for driven in servo_group(arm).driven_joints:
        low, high = driven.tick_range
        seen = ticks.get(driven.servo_id, ())
        found[driven.joint] = max([0, *(max(low - tick, tick - high) for tick in seen)])
    return found


def fall_out_of_limits(arm, seed):
    """Let the shoulder and the elbow of a limp arm be past a limit each, as by their weight."""
    random = np.random.default_rng(seed)
    lower, upper = arm.limits()
    for column in (1, 2):
        where = random.choice([lower[column] - BEYOND_RAD, upper[column] + BEYOND_RAD])
        line_of(arm).world.place(arm.joint_names[column], float(where))


@pytest.mark.sample(6)
@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("name", ARMS)
def test_limp_arm_outside_its_limits_is_only_moved_back_inside(name, seed):
    with ikservo.open_arm(name, port="sim", collisions=False) as arm:
        fall_out_of_limits(arm, seed)
        arm.enable()
        present = {servo.id: {servo.read("goal_position")} for servo in line_of(arm).world.servos}
        witness, held = GoalWitness(arm), excess_ticks(arm, present)
        arm.return_within_limits()
        arm.move_joints({arm.joint_names[0]: arm.where().positions_rad[0] + 0.1})
        assert all(
            excess <= held[joint] for joint, excess in excess_ticks(arm, witness.goals).items()
        )


def test_hold_clips_goal_of_another_program_to_joint_limit():
    with ikservo.open_arm("so101", port="sim:?pose=home") as arm:
        arm.enable()
        group = servo_group(arm)
        ticks, driven = group._feedback.measure_ticks(), group.driven_joints[0]
        ticks[0] = high = driven.tick_range[1]
        group._bus.sync_write(RegisterName.GOAL_POSITION, {driven.servo_id: high + 20}, raw=True)
        still = SimpleNamespace(measure_ticks=lambda: ticks)
        assert hold_ticks(group._bus, group.driven_joints, still)[0] == high


def test_bus_write_of_goal_beyond_joint_limit_is_refused():
    with ikservo.open_arm("so101", port="sim:?pose=home") as arm:
        arm.enable()
        group, sent = servo_group(arm), GoalWitness(arm)
        driven = group.driven_joints[1]
        _, high = driven.tick_range
        with pytest.raises(RefusedError):
            group._write_goals({driven.servo_id: high + 1})
        arm.where()
        assert not sent.goals
