"""ROS 2 messages without ROS: types, encoding, and the messages of an arm."""
