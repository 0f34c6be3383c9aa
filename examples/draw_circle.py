"""Draw a circle in the air with a constant speed of the tip."""

import ikservo

CENTRE_M = (0.21, 0.0, 0.12)
RADIUS_M = 0.03

with ikservo.open_arm("so101", port="sim") as arm:
    arm.move_to((CENTRE_M[0] + RADIUS_M, CENTRE_M[1], CENTRE_M[2]))
    report = arm.move_arc(center_m=CENTRE_M, tool_speed_m_s=0.04)  # about a vertical axis
    print(f"largest distance from the circle  {report.path_error_max_m * 1000:.2f} mm")
    print(f"mean distance (rms)               {report.path_error_rms_m * 1000:.2f} mm")
