"""Teach, record, replay and follow; programs and drawings."""

from ikservo.app import App, Command

APP = App(
    name="teaching",
    names={"read_recording": "ikservo.apps.teaching.recorder:read_recording"},
    arm_methods={
        "record": "ikservo.apps.teaching.recorder:record_open_arm",
        "replay": "ikservo.apps.teaching.replaying:replay",
        "load_replay": "ikservo.apps.teaching.replaying:load_replay",
    },
    motions={"replay": "ikservo.apps.teaching.replaying:Replay"},
    commands={
        "import dataset": Command(
            "ikservo.apps.teaching.import_dataset_command",
            "Import the episodes of a LeRobotDataset, each as a recording.",
            "Set up",
        ),
        "export": Command(
            "ikservo.apps.teaching.export_command",
            "Export a calibration to LeRobot, or a recording to CSV.",
            "Set up",
        ),
        "draw": Command(
            "ikservo.apps.teaching.draw_command",
            "Draw the strokes of an SVG or CSV file.",
            "Move",
        ),
        "teach": Command(
            "ikservo.apps.teaching.teach_command",
            "Save the pose of an arm moved by hand.",
            "Teach and replay",
        ),
        "record": Command(
            "ikservo.apps.teaching.record_command",
            "Record a motion to a file; show it live in Foxglove.",
            "Teach and replay",
        ),
        "replay": Command(
            "ikservo.apps.teaching.replay_command",
            "Replay a recorded motion.",
            "Teach and replay",
        ),
        "program": Command("", "Write, check and run a file of steps.", "Teach and replay"),
        "program new": Command(
            "ikservo.apps.teaching.program_command:new",
            "Write an example program.",
            "Teach and replay",
        ),
        "program check": Command(
            "ikservo.apps.teaching.program_command:check",
            "Plan each step; nothing moves.",
            "Teach and replay",
        ),
        "program run": Command(
            "ikservo.apps.teaching.program_command:run",
            "Check all steps, then carry them out.",
            "Teach and replay",
        ),
        "follow": Command(
            "ikservo.apps.teaching.follow_command",
            "Follow another arm that is guided by hand.",
            "Teach and replay",
        ),
    },
    parts={
        "import recording": "ikservo.apps.teaching.mcap_recording:read_calibration_text",
        "program": "ikservo.apps.teaching.program:parse_program",
    },
)
