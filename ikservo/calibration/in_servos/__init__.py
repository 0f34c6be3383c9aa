"""What of a calibration stands in the servos: compared, and written as one transaction."""
