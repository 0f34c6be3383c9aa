"""Take an object at one place and put it down at another one.

python examples/pick_and_place.py                 a simulated SO-101, without an object
python examples/pick_and_place.py /dev/ttyACM0    a real arm: put an object at PICK_M
"""

import math
import sys

import ikservo

PICK_M, PLACE_M = (0.24, 0.08, 0.04), (0.24, -0.08, 0.04)
ABOVE_M = 0.06
DOWN = ikservo.ToolOrientation(pitch_rad=-1.2)  # the tool points downwards

port = sys.argv[1] if len(sys.argv) > 1 else "sim:?pose=home"


def above(point_m):
    """Return the point above a place."""
    return (*point_m[:2], point_m[2] + ABOVE_M)


with ikservo.open_arm("so101", port=port) as arm:
    arm.gripper("open")
    for place_m, action in ((PICK_M, "close"), (PLACE_M, "open")):
        arm.move_to(above(place_m), stance=DOWN)
        arm.move_line(place_m, stance=DOWN)
        report = arm.gripper(action, force=0.2)
        arm.move_line(above(place_m), stance=DOWN)
        held_deg = math.degrees(arm.where().positions["gripper"])
        print(f"{action}: grasped {report.grasped}, the gripper is at {held_deg:.0f}°")
    arm.pose("home")
