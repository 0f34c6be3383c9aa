"""What stands on the line: packets, their stuffing, and which answer belongs to which question."""
