"""Who is on the line: scans, roll calls, a closer look, two servos with one id."""
