"""Single servos and their bus: ids, registers, gains, faults."""

from ikservo.app import App, Command

APP = App(
    name="workbench",
    commands={
        "scan": Command(
            "ikservo.apps.workbench.scan_command",
            "Find servos at any id and baud rate.",
            "Set up",
        ),
        "setup": Command(
            "ikservo.apps.workbench.setup_command",
            "Give new servos their ids, one at a time.",
            "Set up",
        ),
        "servo": Command(
            "ikservo.apps.workbench.servo_command",
            "Read and write registers of single servos; back up, restore.",
            "Set up",
        ),
        "doctor": Command(
            "ikservo.apps.workbench.doctor_command",
            "Check adapter, bus and servos and report faults.",
            "Set up",
        ),
        "bench": Command(
            "ikservo.apps.workbench.bench_command",
            "Measure how fast servos can be read and written.",
            "Set up",
        ),
    },
)
