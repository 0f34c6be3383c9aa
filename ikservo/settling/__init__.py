"""The end of a motion, in which joints are corrected by their measured positions."""
