"""Motions as values, and the plans that are made and checked of them before anything moves."""
