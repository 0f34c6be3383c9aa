"""The calibration as a file: where it lies, read whole or not at all, checked before belief."""
