"""An arm in a graph of ROS 2, without ROS: through Zenoh, as rmw_zenoh speaks it."""

from ikservo.app import App, Command

APP = App(
    name="ros",
    commands={
        "ros": Command(
            "ikservo.apps.ros.ros_command",
            "Connect an arm to ROS 2, without ROS on this machine.",
            "Other machines",
        ),
    },
)
