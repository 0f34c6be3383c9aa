"""Move two arms at the same time from one program."""

import ikservo

with (
    ikservo.open_arm("so101", port="sim:?pose=home") as left,
    ikservo.open_arm("koch", port="sim:?pose=home") as right,
):
    motions = [
        left.move_joints({"shoulder_pan": 0.4}, wait=False),  # returns at once
        right.move_joints({"shoulder_pan": -0.4}, wait=False),
    ]
    for motion in motions:
        report = motion.wait()
        print(f"reached: {report.reached}, {report.duration_s:.1f} s")
