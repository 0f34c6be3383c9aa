"""The panels of the page beside the view."""
