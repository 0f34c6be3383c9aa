"""How an arm on a port gets its calibration: by hand, by itself, by touch, from a file."""
