"""Teach, record, replay and follow; programs and drawings."""
