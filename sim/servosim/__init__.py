"""A simulated servo bus, written from the datasheets."""
