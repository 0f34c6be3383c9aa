"""Brief motions: some tenths of a second of streamed goals, without planning, arrival and rest.

What guards a long motion guards these at every beat; ten thousand of them take minutes.
"""

import ikservo
from ikservo.control.loop import ControlLoop
from ikservo.motion import JointMove
from tests.arm.simulated import motion_limits, servo_group


def opened(name, seed):
    """Open a simulated arm whose chance is its own."""
    return ikservo.open_arm(name, port=f"sim:?pose=home&seed={seed}", collisions=False)


def brief_move(arm, dice, speed, most_rad=0.1):
    """Return a course from the present goals by up to so much in every joint, inside its limits."""
    servos = servo_group(arm)
    start = servos.goals()
    goal = start.copy()
    for i, fence in enumerate(servos.fences):
        low, high = fence.position_range
        way = dice.uniform(-most_rad, most_rad) * fence.joint_map.unit_per_tick * 4096 / 6.2832
        goal[i] = min(max(start[i] + way, min(low, start[i])), max(high, start[i]))
    return JointMove(start, goal, motion_limits(arm, speed))


def streamed(arm, dice, on_cycle=None):
    """Carry out a brief motion; return its course."""
    speed = dice.choice(("normal", "fast"))
    move = brief_move(arm, dice, speed)
    ControlLoop(servo_group(arm)).run(move, on_cycle, speed_rad_s=arm.model.speed(speed).rad_s)
    return move
