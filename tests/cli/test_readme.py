"""Facts of README besides the blocks that run (those: tests/docs)."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text("utf-8")


def test_readme_shows_commands_of_demo():
    makefile = (ROOT / "Makefile").read_text("utf-8")
    demo = re.search(r"^demo:.*\n\t@\$\(BIN\)/(ikservo .*)$", makefile, re.M)[1]
    assert f"```console\n$ {demo}\n" in README


def test_readme_commands_lead_from_setup_to_first_motion():
    journey = README.partition("## First motion")[2].partition("\n## ")[0]
    commands = re.findall(r"^ikservo (\w+)", journey, re.M)
    assert commands == ["setup", "doctor", "calibrate", "move", "relax"]


def test_readme_warns_before_first_command_that_needs_an_arm():
    assert "one hand at the switch" in " ".join(README.partition("ikservo setup")[0].split())


def test_readme_says_how_to_put_ikservo_on_the_path():
    assert "source .venv/bin/activate" in README


def test_readme_has_at_most_110_lines_and_900_words():
    assert len(README.splitlines()) <= 110
    assert len(README.split()) <= 900
