"""Calibrate an arm: zeros, signs and ranges by hand, against its stops, by touching a sheet."""

from ikservo.app import App, Command

APP = App(
    name="calibrating",
    commands={
        "calibrate": Command(
            "ikservo.apps.calibrating.calibrate_command",
            "Measure this arm's zeros, signs and ranges.",
            "Set up",
        ),
        "calibration": Command(
            "ikservo.apps.calibrating.calibration_command",
            "Compare a calibration with the servos: diff, push, pull.",
            "Set up",
        ),
        "import": Command(
            "ikservo.apps.calibrating.import_command",
            "Import a calibration from LeRobot or a recording.",
            "Set up",
        ),
    },
)
