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
        "import": Command("", "Import a calibration from LeRobot or a recording.", "Set up"),
        "import lerobot": Command(
            "ikservo.apps.calibrating.import_command",
            "Import ids and ranges from LeRobot.",
            "Set up",
        ),
        "import recording": Command(
            "ikservo.apps.calibrating.import_recording_command",
            "Import the calibration with which a recording was made.",
            "Set up",
        ),
    },
    parts={
        "test --touch": "ikservo.apps.calibrating.accuracy_by_touch:measure_by_touch",
    },
)
