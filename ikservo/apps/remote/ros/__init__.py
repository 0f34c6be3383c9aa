"""An arm in a ROS 2 graph without ROS, using the protocol of rmw_zenoh."""
