"""Run a command in this process; return its exact stdout, stderr and exit code."""

import json
from dataclasses import dataclass

import pytest

from ikservo.cli import main


@dataclass
class CommandResult:
    """Exit code and both output streams of a command."""

    code: int
    out: str
    err: str

    @property
    def json(self):
        return json.loads(self.out)


@pytest.fixture
def run_cli(capsys, monkeypatch):
    """Return a function that runs ``ikservo`` with the given command line or words."""
    for name in ("IKSERVO_ARM", "IKSERVO_PORT"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("COLUMNS", "100")

    def run(words):
        code = main(words.split() if isinstance(words, str) else words)
        captured = capsys.readouterr()
        return CommandResult(code, captured.out, captured.err)

    return run
