"""Fixtures for tests of the apps' commands."""

from tests.cli.conftest import run_cli

__all__ = ["run_cli"]
