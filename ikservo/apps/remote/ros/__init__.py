"""An arm in a graph of ROS 2, without ROS: through Zenoh, as rmw_zenoh speaks it."""
