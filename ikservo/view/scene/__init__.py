"""What is drawn: the arm, its ghost, dials, the reachable region, the lesson."""
