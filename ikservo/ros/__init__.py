"""Messages of ROS 2 without ROS: types, encoding, what an arm says in them."""
