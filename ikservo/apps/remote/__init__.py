"""Arms on other machines: addresses, sessions, messages, the arm's server and its clients."""

from ikservo.app import App, Command

APP = App(
    name="remote",
    commands={
        "serve": Command(
            "ikservo.apps.remote.serve_command",
            "Serve an arm to programs on other machines.",
            "Other machines",
        ),
        "ros": Command(
            "ikservo.apps.remote.ros_command",
            "Connect an arm to ROS 2, without ROS on this machine.",
            "Other machines",
        ),
        "fleet": Command(
            "ikservo.apps.remote.fleet_command",
            "List the arms of other machines: state, operator, health.",
            "Other machines",
        ),
        "net": Command(
            "", "Make certificates for other machines; acknowledge a stop.", "Other machines"
        ),
        "net keys": Command(
            "ikservo.apps.remote.net_command:keys",
            "Make certificates for arms on other machines.",
            "Other machines",
        ),
        "net acknowledge": Command(
            "ikservo.apps.remote.net_command:acknowledge",
            "Acknowledge a stop of an arm on another machine.",
            "Other machines",
        ),
    },
    parts={"stop": "ikservo.apps.remote.remote_stopper:REMOTE_STOPPER"},
)
