"""Measure an arm: accuracy according to ISO 9283, excitation, identification, health."""

from ikservo.app import App, Command

APP = App(
    name="lab",
    commands={
        name: Command(f"ikservo.apps.lab.{name}_command", text, "Set up")
        for name, text in (
            ("monitor", "Log the health of the servos, and report wear."),
            ("test", "Measure accuracy and repeatability to ISO 9283."),
            ("identify", "Measure this arm's masses, friction, stiffness; moves slowly."),
        )
    },
    parts={"gripper --weigh": "ikservo.apps.lab.weighing:weigh_held_object"},
)
