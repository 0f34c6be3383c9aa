"""Drive an arm on another machine.

Beside the arm:  ikservo serve so101 --name desk --port sim
Here:            python examples/network.py zenoh:desk@127.0.0.1
"""

import sys

import ikservo

address = sys.argv[1] if len(sys.argv) > 1 else "zenoh:desk@127.0.0.1"

with ikservo.open_arm("so101", port=address) as arm:
    report = arm.move_joints({"wrist_roll": 0.2})
    print(f"reached: {report.reached}")
    print(arm.where().positions)
