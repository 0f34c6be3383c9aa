"""Import foreign descriptions for `ikservo arms new`; the package `model` reads the result."""

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
