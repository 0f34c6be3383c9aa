"""Recordings: their formats, read with bounds and written, and what a recording is."""
