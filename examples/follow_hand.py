"""Follow the poses of a tracker: a phone, a glove or a camera instead of this simulated hand."""

import math

import numpy as np

import ikservo


def hand_poses(clock, duration_s):
    """Yield the newest pose (4, 4) of the hand in each cycle, or None if there is no new one."""
    start_s = clock.now_s()
    while (time_s := clock.now_s() - start_s) < duration_s:
        T = np.eye(4)
        T[:3, 3] = 0.0, 0.03 * math.sin(math.pi * time_s), 0.02 * time_s
        yield ikservo.TrackedPose(T, held=True, opening=0.5)


with ikservo.open_arm("so101", port="sim:?pose=home") as arm:
    arm.move_joints(arm.model.pose("home"))  # the first motion after torque comes on is slow
    start_m = arm.where().tip_m
    result = arm.follow_pose(hand_poses(arm.clock, 2.0), scale=1.0)
    moved_mm = 1000.0 * (result.measured_tip_m - start_m)
    print(f"{result.setpoints} goals, {result.refused} refused, up by {moved_mm[2]:.0f} mm")
