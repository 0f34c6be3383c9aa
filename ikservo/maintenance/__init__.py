"""Work on an arm besides moving it: calibration, diagnostics, recovery, new servos."""
