"""Calibration records built field by field."""

from ikservo.calibration.records import Calibration

WHEN = "2026-11-02T14:03:22Z"
STS = {"homing_offset": 0, "operating_mode": 0, "min_position_limit": 0, "max_position_limit": 4095,
       "phase": 12}  # fmt: skip
X = {"homing_offset": 0, "operating_mode": 3, "min_position_limit": 0, "max_position_limit": 4095,
     "drive_mode": 0}  # fmt: skip
SCS = {"min_position_limit": 0, "max_position_limit": 1023}
FAMILIES = {
    "STS3215": ("feetech_sts", STS),
    "XM430-W350": ("dynamixel_2", X),
    "SCS15": ("feetech_scs", SCS),
}
GEOMETRY = {"touched": WHEN, "touches": 9, "left_out": 0, "before_mm": 5.0, "after_mm": 1.0,
            "base_moved_mm": [0.0, 0.0, 0.0], "base_turned_deg": [0.0, 0.0, 0.0]}  # fmt: skip


def joint(name="elbow", servo_id=1, model="STS3215", holds=None, **changes):
    servo = {"id": servo_id, "model": model, "firmware": "3.10",
             "holds": FAMILIES.get(model, ("", {}))[1] | (holds or {})}  # fmt: skip
    return {"name": name, "sign": 1, "sign_from": "by hand", "zero_tick": 2048.0, "gear": 1.0,
            "extended": False, "swept": "by hand", "travel_ticks": [1000, 3000],
            "lower_deg": -80.0, "upper_deg": 80.0, "servo": servo} | changes  # fmt: skip


def calibration_of(*joints, geometry=None, written=WHEN):
    """Return the calibration of an arm with these joints, in the family of the first one."""
    family = FAMILIES.get(joints[0]["servo"]["model"], ("feetech_sts",))[0]
    return Calibration.model_validate_json(
        Calibration.model_construct(
            format=1, arm="so101", written=written, tool_version="1", usb_serial_number="",
            family=family, anchor_pose="home", margin_deg=2.0, joints=joints, geometry=geometry,
        ).model_dump_json(warnings=False)
    )  # fmt: skip
