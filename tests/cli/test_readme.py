"""What README must show besides blocks that run (those: tests/docs)."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text("utf-8")


def test_readme_shows_what_the_demo_runs():
    makefile = (ROOT / "Makefile").read_text("utf-8")
    demo = re.search(r"^demo:.*\n\t@\$\(BIN\)/(ikservo .*)$", makefile, re.M)[1]
    assert f"```console\n$ {demo}\n" in README


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
