"""Calibrate zeros, signs and ranges: by hand, against end stops, or by touching a sheet."""

from ikservo.app import App, Command

APP = App(
    name="calibrating",
    commands={
        name: Command(place and f"ikservo.apps.calibrating.{place}", text, "Set up")
        for name, place, text in (
            ("calibrate", "calibrate_command", "Measure this arm's zeros, signs and ranges."),
            ("calibration", "", "Compare a calibration with the servos: diff, push, pull."),
            *(
                (f"calibration {word}", f"calibration_command:{function}", text)
                for word, function, text in (
                    ("show", "show", "Print zeros, signs and ranges."),
                    ("diff", "diff", "Compare the file with the servos."),
                    ("push", "push", "Write the file into the servos."),
                    ("pull", "pull", "Write the servos' values into the file."),
                    ("adopt", "adopt", "Use the calibration made with another adapter."),
                    ("restore", "restore", "Replace a damaged file with the previous one."),
                    ("undo", "undo", "Return to the previous calibration."),
                    ("resume", "complete_write", "Complete an interrupted write."),
                    ("revert", "revert", "Undo an interrupted write."),
                )
            ),
            ("import", "", "Import a calibration from LeRobot or a recording."),
            ("import lerobot", "import_command", "Import ids and ranges from LeRobot."),
            (
                "import recording",
                "import_recording_command",
                "Import the calibration with which a recording was made.",
            ),
        )
    },
    parts={"test --touch": "ikservo.apps.calibrating.accuracy_by_touch:measure_by_touch"},
)
