"""The commands that README shows print what README says they print."""

import io
import re
from pathlib import Path

import pytest

from ikservo.cli import main
from ikservo.cli.app import COMMANDS, app

README = (Path(__file__).parents[2] / "README.md").read_text("utf-8")
NUMBER = r"-?\d+(?:\.\d+)?"


def shown():
    """Each command of a console block and the lines below it."""
    for block in re.findall(r"```console\n(.*?)```", README, re.S):
        for command in block.split("$ ")[1:]:
            words, _, lines = command.partition("\n")
            yield words, lines


def pattern(lines):
    """What was shown as an expression: numbers may differ, `…` stands for anything."""
    tokens = re.split(rf"({NUMBER}|…|\s+)", lines.strip())
    forms = {"…": ".*"}
    return "".join(
        forms.get(token)
        or (
            NUMBER
            if re.fullmatch(NUMBER, token)
            else r"\s+"
            if token.isspace()
            else re.escape(token)
        )
        for token in tokens
        if token
    )


@pytest.mark.parametrize(("words", "lines"), list(shown()))
def test_a_command_prints_what_readme_shows(words, lines, monkeypatch, tmp_path):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    out = io.StringIO()
    monkeypatch.setattr("sys.stdout", out)
    monkeypatch.setattr("sys.stderr", out)
    assert main(words.split()[1:]) == 0
    assert re.fullmatch(pattern(lines), out.getvalue().strip()), out.getvalue()


def test_readme_shows_what_the_demo_runs():
    makefile = (Path(__file__).parents[2] / "Makefile").read_text("utf-8")
    demo = re.search(r"^demo:.*\n\t@\$\(BIN\)/(ikservo .*)$", makefile, re.M)[1]
    assert demo in [words for words, _ in shown()]


def test_every_command_in_readme_exists_with_its_options():
    import typer

    group = typer.main.get_command(app)
    for line in re.findall(r"^(?:\$ )?ikservo ([a-z]+.*)$", README, re.M):
        name, *words = line.partition("#")[0].split()
        assert name in COMMANDS
        options = {text for param in group.get_command(None, name).params for text in param.opts}
        assert {word.partition("=")[0] for word in words if word.startswith("--")} <= options


def test_readme_leads_from_plugging_in_to_the_first_motion():
    journey = README.partition("## From the box")[2].partition("\n## ")[0]
    order = [
        journey.find(f"ikservo {word} ")
        for word in ("doctor", "scan", "setup", "calibrate", "move")
    ]
    assert -1 not in order
    assert order == sorted(order)


def test_readme_says_how_the_command_gets_on_the_path():
    assert "source .venv/bin/activate" in README
