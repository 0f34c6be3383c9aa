"""The command line, one module per command.

stdout is for data, stderr for everything else. A command imports only what it uses, so that
``ikservo --help`` prints at once.
"""

from ikservo.cli.entry_point import console, main

__all__ = ["console", "main"]
