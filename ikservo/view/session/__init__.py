"""What happens between the page and the arm: gestures in, motion out, calibration as screens."""
