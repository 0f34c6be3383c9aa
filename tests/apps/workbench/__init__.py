"""Tests of the workbench app."""
