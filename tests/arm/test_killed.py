"""A program that dies in mid-motion: how far the joints still go, in virtual time."""

import numpy as np
import pytest

import ikservo
from ikservo.control.loop import ControlLoop
from ikservo.motion import JointMove
from tests.arm.random_faults import random_goals, seeded
from tests.arm.seeds import few_or_many, log
from tests.arm.simulated import motion_limits, registers, servo_group

MOST_TICKS = 60  # 5.3 degrees
MOST_LOADED_TICKS = 66  # of an arm with the payload of its file, whose weight pulls its joints on
ARMS = ("so101", "koch", "wx250s", "vx300s", "open_manipulator_x", "omx_f", "px100")


class DeadError(BaseException):
    """The program is gone."""


@few_or_many(14, 140)
def test_no_joint_travels_further_than_60_ticks_after_its_program_has_died(seeds, capsys):
    worst = {(name, payload): 0 for name in ARMS for payload in (0, 1)}
    for seed in seeds:
        name, payload = ARMS[seed % len(ARMS)], seed // len(ARMS) % 2
        gone = travel(name, seeded(seed), payload)
        worst[name, payload] = max(worst[name, payload], gone)
    empty, loaded = ({name: worst[name, payload] for name in ARMS} for payload in (0, 1))
    log(capsys, f"{len(seeds)} dead programs: at most {empty} ticks, with a payload {loaded}")
    assert max(empty.values()) <= MOST_TICKS
    assert max(loaded.values()) <= MOST_LOADED_TICKS


def travel(name, dice, payload):
    """Return how far the furthest joint goes once nobody speaks any more, ticks.

    Args:
        name: The arm.
        dice: Chooses motion and time.
        payload: How much it carries, as a share of the payload in its file.
    """
    payload_g = 1000.0 * payload * ikservo.load_model(name).payload_kg
    with ikservo.open_arm(name, port=f"sim:?payload_g={payload_g}", collisions=False) as arm:
        arm.enable()
        servos, speed = servo_group(arm), "fast"
        goals, _ = random_goals(arm, dice, speed)
        start, goal = servos.reference(), np.array([goals[joint] for joint in servos.names])
        move = JointMove(start, goal, motion_limits(arm, speed))
        at_s, found = dice.uniform(0.2, 0.9) * move.duration_s, []

        def die(cycle):
            if cycle.time_s >= at_s:
                before = registers(arm, "present_position")
                servos.clock.sleep_until(servos.clock.now_s() + 1.5)
                after = registers(arm, "present_position")
                found.append(max(abs(after[i] - before[i]) for i in before))
                raise DeadError

        with pytest.raises(DeadError):
            ControlLoop(servo_group(arm)).run(move, die, speed_rad_s=arm.model.speed(speed).rad_s)
        return found[0]
