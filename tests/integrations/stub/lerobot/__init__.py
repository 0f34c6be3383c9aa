"""What ikservo's plug-in uses of LeRobot, described by us; ``make lerobot`` compares it."""
