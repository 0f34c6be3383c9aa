"""The panels of the page, next to the view."""
