"""Tests of the lab app."""
