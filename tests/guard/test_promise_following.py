"""M7: a joint that does not follow stops the arm within three beats, by name."""

import numpy as np
import pytest

import ikservo
from ikservo.arm.streaming.stream import Stream
from ikservo.errors import RefusedError
from ikservo.motion import JointMove, Pace
from servosim.faults import Fault
from tests.arm.simulated import line_of

PACE = Pace(1.0, 3.0, 30.0)
JOINTS = ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper"]


def jam(joint, after_s):
    """Return the beats for which a jammed joint was too far behind, and the refusal."""
    with ikservo.open_arm("so101", port="sim", collisions=False) as arm:
        arm.enable()
        servos = arm._servos
        at, start = servos.names.index(joint), servos.goals()
        goal = start.copy()
        middle = [(f.limits.lower.value + f.limits.upper.value) / 2 for f in servos.fences]
        goal[at] += 1.2 if start[at] < middle[at] else -1.2
        fence, behind = servos.fences[at], []
        most = 0.9 * fence.lead_ticks(PACE.speed_rad_s) * fence.joint_map.unit_per_tick
        now_s = servos.clock.now_s()
        fault = Fault("stuck", id=fence.servo_id, at_s=now_s + after_s, for_s=60.0)
        line_of(arm).faults.add(fault)
        move = JointMove(start, goal, [PACE] * len(start))
        with pytest.raises(RefusedError) as caught:
            Stream(servos).run(
                move,
                lambda beat: behind.append(abs(beat.goals[at] - beat.measured[at]) > most),
                speed_rad_s=PACE.speed_rad_s,
            )
        return sum(behind), str(caught.value)


@pytest.mark.parametrize("joint", JOINTS[::2])
def test_a_jammed_joint_is_named_at_the_third_beat_that_it_is_too_far_behind(joint):
    beats, words = jam(joint, 0.4)
    assert words.startswith(f"{joint} does not follow its goal")
    assert beats <= 3


@pytest.mark.campaign
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("joint", JOINTS)
def test_a_joint_that_jams_at_any_time_of_its_motion_is_named(joint):
    most = 0
    for after_s in np.linspace(0.0, 0.9, 100):
        beats, words = jam(joint, after_s)
        assert words.startswith(f"{joint} does not follow its goal")
        most = max(most, beats)
    print(f"{joint}: 100 of 100 jams named, at most {most} beats too far behind")  # noqa: T201  # a number to keep
    assert most <= 3
