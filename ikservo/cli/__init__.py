"""Words: what a person types, one file a command.

stdout carries data, stderr everything else. A command imports only what it uses, so that
``ikservo --help`` answers at once.
"""

from ikservo.cli.entry_point import console, main

__all__ = ["console", "main"]
