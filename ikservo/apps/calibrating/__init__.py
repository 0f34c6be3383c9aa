"""Calibrate an arm: zeros, signs and ranges by hand, against its stops, by touching a sheet."""
