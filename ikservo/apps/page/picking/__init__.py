"""Picking with the mouse, and projections of the views."""
