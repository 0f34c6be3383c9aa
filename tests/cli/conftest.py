"""Run a command as a person does, in this process: exact stdout, stderr and exit code."""

import json
from dataclasses import dataclass

import pytest

from ikservo.cli import main


@dataclass
class Said:
    """What a command left behind."""

    code: int
    out: str
    err: str

    @property
    def json(self):
        return json.loads(self.out)


@pytest.fixture
def say(capsys, monkeypatch):
    """Return a function that runs ``ikservo`` with the given words."""
    for name in ("IKSERVO_ARM", "IKSERVO_PORT"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("COLUMNS", "100")

    def run(words):
        code = main(words.split())
        captured = capsys.readouterr()
        return Said(code, captured.out, captured.err)

    return run
