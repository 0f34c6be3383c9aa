"""Move the tip to a point, and print where it really is.

python examples/move.py                 a simulated SO-101
python examples/move.py /dev/ttyACM0    a real one
"""

import sys

import ikservo

port = sys.argv[1] if len(sys.argv) > 1 else "sim"

with ikservo.open_arm("so101", port=port) as arm:
    report = arm.move_to((0.25, 0.05, 0.15))  # metres: forward, left, up
    print(f"target    {report.target_m}")
    print(f"measured  {report.measured_tip_m}")
    print(f"error     {report.error_m * 1000:.2f} mm")
