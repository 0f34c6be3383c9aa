"""Send goals at 100 Hz: the program decides where the arm goes while it moves."""

import math

import ikservo

RATE_HZ, DURATION_S = 100, 1.5

with ikservo.open_arm("so101", port="sim:?pose=home") as arm:
    start = arm.where().positions
    with arm.stream(speed="fast", rate_hz=RATE_HZ) as stream:
        for step in range(int(RATE_HZ * DURATION_S)):
            time_s = step / RATE_HZ
            pan = start["shoulder_pan"] + 0.2 * math.sin(2.0 * math.pi * 0.5 * time_s)
            stream.send({"shoulder_pan": pan})  # returns when the next goal is due
    print(f"{stream.sent} goals sent, {stream.refused} refused")
