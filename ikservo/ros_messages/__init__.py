"""Messages of ROS 2 without ROS: types, encoding, and the messages of an arm."""
