"""Find a red cube in the picture of a calibrated camera, and pick it up.

ikservo calibrate so101 --camera sim --port "sim:?pose=home"     first, and once
python examples/camera_pick.py                 a simulated SO-101, without the board on its gripper
python examples/camera_pick.py /dev/ttyACM0    a real one: take the board off its gripper
"""

import math
import sys

import numpy as np

import ikservo

CUBE_M, ABOVE_M, AXIS_M = 0.035, 0.10, 0.039  # the first joint is AXIS_M before the base's origin
BESIDE_M = 0.022  # the tip is at the fixed jaw, that far from the middle of what is gripped
DOWN = ikservo.ToolOrientation(pitch_rad=math.radians(-75), roll_rad=math.radians(90))

port = sys.argv[1] if len(sys.argv) > 1 else "sim:?pose=home&board=0&physics=1&cubes=red@0.24,0.05"


def find_red(picture):
    """Return the middle pixel of all that is red."""
    blue, green, red = np.moveaxis(picture.astype(int), 2, 0)
    v, u = np.nonzero(red > 2 * np.maximum(blue, green) + 20)
    return u.mean(), v.mean()


with ikservo.open_arm("so101", port=port) as arm:
    arm.gripper("open")
    x, y, _ = arm.camera.point_on_table(*find_red(arm.camera.picture()), height_m=CUBE_M / 2)
    heading = math.atan2(y, x - AXIS_M)
    x, y = x - BESIDE_M * math.sin(heading), y + BESIDE_M * math.cos(heading)
    arm.move_to((x, y, ABOVE_M), stance=DOWN)
    arm.move_line((x, y, 0.028), stance=DOWN)
    print(f"grasped: {arm.gripper('close').grasped}")
    arm.move_line((x, y, ABOVE_M), stance=DOWN)
    away = np.subtract(find_red(arm.camera.picture()), arm.camera.pixel(arm.where().tip_m))
    print(f"the camera sees the cube {np.linalg.norm(away):.0f} px from the tip")
