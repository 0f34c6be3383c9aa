"""Arrival: on whole ticks, corrected by what the joints measure, and said as it is."""
