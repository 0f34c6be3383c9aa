"""Motions as values, and the plans made and checked from them before anything moves."""
