"""What is done to an arm besides moving it: calibration, diagnostics, recovery, new servos."""
