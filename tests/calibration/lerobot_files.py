"""Calibration files as LeRobot writes them, with the registers that it sets."""

import json
import math

from tests.calibration.mounted_arms import load_model


def lerobot_text(arm, free=("wrist_roll",)):
    """Set the registers of a so101 or so100 as LeRobot does; return the text of its file."""
    table = {}
    for joint in load_model(arm.name).joints:
        servo, low_high = arm.line.servos[joint.servo.id], arm.stops[joint.name]
        middle = servo.shaft.tick_at(_middle(joint)) % 4096
        offset = max(-2047, min(2047, (middle - 2047 + 2048) % 4096 - 2048))
        servo.write("lock", 0)
        servo.write("homing_offset", offset)
        servo.write("lock", 1)
        ends = sorted((servo.shaft.tick_at(end) - servo.shaft.tick_at(_middle(joint)))
                      + (middle - offset) % 4096 for end in low_high)  # fmt: skip
        low, high = (0, 4095) if joint.name in free else ends
        table[joint.name] = {"id": joint.servo.id, "drive_mode": 0, "homing_offset": offset,
                             "range_min": low, "range_max": high}  # fmt: skip
    return json.dumps(table, indent=4)


def _middle(joint):
    middle = 0.5 * (joint.limits.lower.value + joint.limits.upper.value)
    return 0.0 if math.isclose(middle, 0.0, abs_tol=0.1) else middle
