"""Short motions: tenths of a second of control cycles, without planning and settling.

Every check of a long motion acts in each cycle of these; ten thousand of them take minutes.
"""

import ikservo
from ikservo.control.loop import ControlLoop
from ikservo.motion import JointMove
from tests.arm.simulated import motion_limits, servo_group


def open_simulated(name, seed):
    """Open a simulated arm with a random seed."""
    return ikservo.open_arm(name, port=f"sim:?pose=home&seed={seed}", collisions=False)


def short_move(arm, dice, speed, max_rad=0.1):
    """Return a trajectory that moves each joint by `max_rad` inside its limits."""
    servos = servo_group(arm)
    start = servos.goals()
    goal = start.copy()
    for i, driven in enumerate(servos.driven_joints):
        low, high = driven.position_range
        distance = dice.uniform(-max_rad, max_rad) * driven.joint_map.unit_per_tick * 4096 / 6.2832
        goal[i] = min(max(start[i] + distance, min(low, start[i])), max(high, start[i]))
    return JointMove(start, goal, motion_limits(arm, speed))


def run_short_move(arm, dice, on_cycle=None):
    """Run a short motion; return its trajectory."""
    speed = dice.choice(("normal", "fast"))
    move = short_move(arm, dice, speed)
    ControlLoop(servo_group(arm)).run(move, on_cycle, speed_rad_s=arm.model.speed(speed).rad_s)
    return move
