"""The part of LeRobot that ikservo's plug-in uses, as stubs; ``make lerobot`` compares it."""
