"""Arms on other machines: addresses, sessions, messages, the arm's server and its clients."""

from ikservo.app import App, Command

APP = App(
    name="remote",
    commands={
        name: Command(place and f"ikservo.apps.remote.{place}", text, "Other machines")
        for name, place, text in (
            ("serve", "serve_command", "Serve an arm to programs on other machines."),
            ("ros", "ros_command", "Connect an arm to ROS 2, without ROS on this machine."),
            ("fleet", "fleet_command", "List the arms of other machines: state, operator, health."),
            ("net", "", "Make certificates for other machines; acknowledge a stop."),
            ("net keys", "net_command:keys", "Make certificates for arms on other machines."),
            (
                "net acknowledge",
                "net_command:acknowledge",
                "Acknowledge a stop of an arm on another machine.",
            ),
        )
    },
    parts={"stop": "ikservo.apps.remote.remote_stopper:REMOTE_STOPPER"},
)
