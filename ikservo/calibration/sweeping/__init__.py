"""Zeros, signs and ranges found by hand or by feel: a pure machine from readings to states."""
