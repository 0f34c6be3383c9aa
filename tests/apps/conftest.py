"""Fixtures of the commands, for the tests of apps."""

from tests.cli.conftest import run_cli

__all__ = ["run_cli"]
