"""Take an object at one place and put it down at another one, in the simulator."""

import math

import ikservo

PICK_M, PLACE_M = (0.24, 0.08, 0.04), (0.24, -0.08, 0.04)
ABOVE_M = 0.06
DOWN = ikservo.ToolOrientation(pitch_rad=-1.2)  # the hand points downwards


def above(point_m):
    """Return the point above a place."""
    return (*point_m[:2], point_m[2] + ABOVE_M)


with ikservo.open_arm("so101", port="sim:?pose=home") as arm:
    arm.gripper("open")
    for place_m, action in ((PICK_M, "close"), (PLACE_M, "open")):
        arm.move_to(above(place_m), stance=DOWN)
        arm.move_line(place_m, stance=DOWN)
        report = arm.gripper(action, force=0.2)
        arm.move_line(above(place_m), stance=DOWN)
        print(f"{action}: the gripper is at {math.degrees(report.position_rad):.0f}°")
    arm.pose("home")
