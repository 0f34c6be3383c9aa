"""Pick things up and put them down."""

from ikservo.app import App, Command

APP = App(
    name="grasping",
    arm_values={"grip": "ikservo.apps.grasping.pick_and_place:Grip"},
    arm_methods={
        "pick": "ikservo.apps.grasping.pick_and_place:pick",
        "place": "ikservo.apps.grasping.pick_and_place:place",
    },
    motions={
        "pick": "ikservo.apps.grasping.pick_and_place:Pick",
        "place": "ikservo.apps.grasping.pick_and_place:Place",
    },
    parts={
        "pick box": "ikservo.apps.grasping.pick_and_place:pick_box",
        "put down": "ikservo.apps.grasping.pick_and_place:Place",
    },
    commands={
        "pick": Command(
            "ikservo.apps.grasping.pick_command", "Pick something up, and put it down.", "Move"
        ),
    },
)
