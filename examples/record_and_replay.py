"""Record the joints of an arm to a file, then let the arm repeat the motion.

With a real arm, switch torque off and guide it by hand while it is recorded.
"""

import ikservo

FILE = "wave.jsonl"

with ikservo.open_arm("so101", port="sim:?pose=home") as arm:
    arm.record(FILE, duration_s=0.5)
    recording = ikservo.read_recording(FILE)
    print(f"{len(recording.times_s)} samples in {recording.times_s[-1]:.2f} s")
    report = arm.replay(FILE)
    print(f"replayed in {report.duration_s:.1f} s")
