"""Settling: correct the goals at the end of a motion until the measured joints arrive."""
