"""Work on single servos and their bus: ids, registers, gains, faults."""

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
            "", "Read and write registers of single servos; back up, restore.", "Set up"
        ),
        **{
            f"servo {word}": Command(f"ikservo.apps.workbench.servo_command:{word}", text, "Set up")
            for word, text in (
                ("table", "Print every register of a servo."),
                ("read", "Read registers."),
                ("write", "Write registers."),
                ("ping", "Print model and firmware."),
                ("reboot", "Restart a servo; torque goes off."),
                ("reset", "Reset a servo to its factory settings."),
                ("backup", "Copy the EEPROM to a file."),
                ("restore", "Write a backup into a servo."),
                ("packets", "Print a file of recorded packets."),
                ("plot", "Plot registers or angles over time."),
                ("tune", "Measure how well a joint follows its goals."),
            )
        },
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
