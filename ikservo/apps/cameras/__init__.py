"""Cameras: where one stands, what it says of the arm's joints, boards, and pictures."""

from ikservo.app import App, Command

APP = App(
    name="cameras",
    commands={
        "camera": Command(
            "ikservo.apps.cameras.camera_command",
            "Print the board of a camera, or check whether a camera has moved.",
            "Set up",
        ),
        "look": Command(
            "ikservo.apps.cameras.look_command",
            "Find the point that a pixel of the camera sees; move there.",
            "Move",
        ),
    },
)
