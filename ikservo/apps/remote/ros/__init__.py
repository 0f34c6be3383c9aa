"""An arm in a graph of ROS 2 without ROS, by the protocol of rmw_zenoh."""
