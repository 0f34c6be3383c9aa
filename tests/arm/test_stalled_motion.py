"""Positions of the joints when a stalled program continues its motion."""

import numpy as np
import pytest

import ikservo
from ikservo.control.loop import ControlLoop
from tests.arm.simulated import clock_of, context_of, line_of, servo_group

STALL_S = 0.6
LEFT_RAD = 4.5 * np.pi / 2048  # near its end feedback leaves that, for settling


def errors_rad(name, joint, stall_s):
    """Return the tracking error of a joint in each cycle of the second half of its motion."""
    with ikservo.open_arm(name, port="sim:?pose=home", collisions=False) as arm:
        arm.enable()
        servos, found, stalls = servo_group(arm), [], [stall_s]
        start = servos.reference()
        goal = {joint: start[servos.names.index(joint)] + 0.8}
        move = context_of(arm).planner.plan_to_joints(start, goal, "normal").trajectory
        at = line_of(arm).world.joint(joint)

        def watch(cycle):
            if cycle.time_s < 0.5 * move.duration_s:
                return
            if stalls:
                clock_of(arm).sleep_until(clock_of(arm).now_s() + stalls.pop())
            found.append(at.position - cycle.reference[servos.names.index(joint)])

        speed_rad_s = arm.model.speed("normal").rad_s
        ControlLoop(servos).run(move, watch, speed_rad_s=speed_rad_s)
        return np.abs(found[1:])


@pytest.mark.full
@pytest.mark.parametrize(("name", "joint"), [("so101", "elbow_flex"), ("koch", "shoulder_pan")])
def test_joint_stays_near_its_path_after_program_stalls(name, joint):
    usual, after = (errors_rad(name, joint, stall_s) for stall_s in (0.0, STALL_S))
    assert usual.max() < 0.008
    assert after.max() < 0.06  # it went on to its last goal, which led it by so much
    assert after[-1] < LEFT_RAD
