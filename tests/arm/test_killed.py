"""After a program dies in mid-motion: how far the joints still go, in virtual time."""

import numpy as np
import pytest

import ikservo
from ikservo.control.loop import ControlLoop
from ikservo.motion import JointMove
from tests.arm.random_faults import random_goals, seeded
from tests.arm.seeds import campaign, few_or_many, log
from tests.arm.simulated import motion_limits, registers, servo_group

MOST_TICKS = 60  # 5.3 degrees
# Their joints sank far under the payload when their watchdog had made their position their goal.
SUNK = ("open_manipulator_x", "omx_f")
ARMS = ("so101", "koch", "wx250s", "vx300s", "open_manipulator_x", "omx_f", "px100")


class DeadError(BaseException):
    """Ends the program as if it were killed."""


@pytest.mark.full
@few_or_many(7, 70)
def test_joint_moves_at_most_60_ticks_after_program_is_killed(seeds, capsys):
    assert max(furthest(ARMS, seeds, 0, capsys).values()) <= MOST_TICKS


@pytest.mark.full
@few_or_many(6, 20)
def test_loaded_joint_does_not_sink_after_program_is_killed(seeds, capsys):
    assert max(furthest(SUNK, seeds, 1, capsys).values()) <= MOST_TICKS


@pytest.mark.parametrize("seeds", [campaign(70)])
def test_joint_with_payload_moves_60_ticks_at_most_after_kill(seeds, capsys):
    assert max(furthest(ARMS, seeds, 1, capsys).values()) <= MOST_TICKS


def furthest(names, seeds, payload, capsys):
    """Return the longest travel of any joint in all trials of each arm, ticks."""
    worst = dict.fromkeys(names, 0)
    for seed in seeds:
        name = names[seed % len(names)]
        worst[name] = max(worst[name], travel(name, seed, payload))
    log(capsys, f"{len(seeds)} dead programs, {payload} x payload: at most {worst} ticks")
    return worst


def travel(name, seed, payload):
    """Return the longest travel of a joint after the program has died, ticks.

    Args:
        name: The arm.
        seed: Seed of the arm's backlash, friction and masses, and of motion and time.
        payload: Payload as a fraction of that in the arm's file.
    """
    dice, payload_g = seeded(seed), 1000.0 * payload * ikservo.load_model(name).payload_kg
    port = f"sim:?seed={seed}&payload_g={payload_g}"
    with ikservo.open_arm(name, port=port, collisions=False) as arm:
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
