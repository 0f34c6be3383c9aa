"""Cameras: their poses, calibration of the arm's joints from pictures, and printed boards."""

from ikservo.app import App, Command

APP = App(
    name="cameras",
    arm_values={"camera": "ikservo.apps.cameras.arm_camera:camera_of"},
    commands={
        "camera": Command(
            "ikservo.apps.cameras.camera_command",
            "Make a calibration board, or check whether a camera has moved.",
            "Set up",
        ),
        "look": Command(
            "ikservo.apps.cameras.look_command",
            "Find the point that a pixel of the camera sees; move there.",
            "Move",
        ),
    },
    parts={
        "calibrate --from-pictures": (
            "ikservo.apps.cameras.calibrate_camera:calibrate_from_pictures"
        ),
        "calibrate --camera": "ikservo.apps.cameras.calibrate_camera:calibrate_by_camera",
    },
)
