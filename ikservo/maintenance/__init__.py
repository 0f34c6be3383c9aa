"""Maintenance of an arm: calibration, diagnostics, recovery, new servos."""
