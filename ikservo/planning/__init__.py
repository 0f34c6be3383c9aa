"""Motions as values, and plans that are made and checked before anything moves."""
