"""The real-time part of an arm: servo group, feedback, control loop and stop requests."""
