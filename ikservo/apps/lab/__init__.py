"""Measure an arm: accuracy according to ISO 9283, excitation, identification, health."""

from ikservo.app import App, Command

APP = App(
    name="lab",
    commands={
        "monitor": Command(
            "ikservo.apps.lab.monitor_command",
            "Log the health of the servos, and report wear.",
            "Set up",
        ),
        "test": Command(
            "ikservo.apps.lab.test_command",
            "Measure accuracy and repeatability to ISO 9283.",
            "Set up",
        ),
        "identify": Command(
            "ikservo.apps.lab.identify_command",
            "Measure this arm's masses, friction, stiffness; moves slowly.",
            "Set up",
        ),
    },
    parts={"gripper --weigh": "ikservo.apps.lab.weighing:weigh_held_object"},
)
