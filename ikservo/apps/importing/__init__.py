"""Foreign descriptions of arms, converted once: what `ikservo arms new` writes, `model` reads."""

from ikservo.app import App, Command

APP = App(
    name="importing",
    commands={
        "arms new": Command(
            "ikservo.apps.importing.arms_new_command",
            "Make the folder of a new arm.",
            "Without an arm",
        ),
    },
)
