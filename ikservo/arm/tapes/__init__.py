"""Motions on file: recorded as JSON lines, read with suspicion, replayed through the guard."""
