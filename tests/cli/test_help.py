"""The first screen: the commands, the exit codes, and nothing imported for it."""

import subprocess
import sys

import pytest

from ikservo.cli.words import WORDS
from ikservo.errors import ExitCode


def test_help_lists_every_command(say):
    out = say("--help").out
    assert all(word in out for word in WORDS)


def test_help_lists_every_exit_code(say):
    out = " ".join(say("--help").out.split())
    assert all(f"{code.value} {code.meaning}" in out for code in ExitCode)


@pytest.mark.parametrize("word", sorted(set(WORDS) - {"sim"}))
def test_every_command_explains_itself(say, word):
    said = say(f"{word} --help")
    assert said.code == 0
    assert f"ikservo {word}" in said.out


def test_no_words_at_all_print_the_help(say):
    said = say("")
    assert "Commands" in said.out + said.err
    assert said.code == 2


def test_an_unknown_command_is_a_usage_error(say):
    said = say("mvoe 1 2 3")
    assert said.code == 2
    assert "mvoe" in said.err


HEAVY = ("numpy", "scipy", "pydantic", "ruckig", "serial", "dynamixel_sdk", "scservo_sdk",
         "servosim", "ikservo.model")  # fmt: skip


@pytest.mark.parametrize(
    ("words", "allowed"),
    [
        ("--help", ()),
        ("arms", ("numpy", "pydantic", "ikservo.model")),
        ("ports", ("serial", "pydantic")),  # typer itself takes pydantic where it runs a command
        ("scan --port /dev/ttyNONE7", ("serial", "pydantic")),
    ],
)
def test_a_command_imports_only_what_it_uses(words, allowed):
    script = (
        "import sys; from ikservo.cli import main; code = main(sys.argv[2:]);"
        "print([m for m in sys.argv[1].split(',') if m in sys.modules], file=sys.stderr)"
    )
    forbidden = ",".join(set(HEAVY) - set(allowed))
    done = subprocess.run([sys.executable, "-c", script, forbidden, *words.split()],
                          capture_output=True, text=True, check=True)  # fmt: skip
    assert done.stderr.strip().splitlines()[-1] == "[]"
