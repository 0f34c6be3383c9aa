"""What the mouse points at, and the projections of the view."""
