"""Find a red block in the picture of a calibrated camera, and pick it up.

ikservo calibrate so101 --camera sim --port "sim:?pose=home"     first, and once
python examples/camera_pick.py                 a simulated SO-101, without the board on its gripper
python examples/camera_pick.py /dev/ttyACM0    a real one: take the board off its gripper
"""

import sys

import ikservo

port = sys.argv[1] if len(sys.argv) > 1 else "sim:?pose=home&board=0&physics=1&cubes=red@0.24,0.05"

with ikservo.open_arm("so101", port=port) as arm:
    red = next(block for block in arm.camera.blocks() if "red" in block.name)
    x, y, _ = 1000 * red.row[9:12]
    print(f"{red.name} is at ({x:.0f}, {y:.0f}) mm")
    print(f"grasped: {arm.pick(red).grasped}")
