"""Every command and option that a message names exists."""

import ast
from functools import cache
from pathlib import Path

import pytest

import ikservo
from ikservo.cli.command_group import all_commands, app
from ikservo.cli.entry_point import COMMAND, with_connection_options

PROSE = ("x", "has", "is", "program", "programs", "wrote")  # "a file that ikservo has written"
SOURCES = Path(ikservo.__file__).parent


def sentences():
    """Yield every string of the program except docstrings; inserted values become ``x``."""
    for path in sorted(SOURCES.rglob("*.py")):
        nodes = list(ast.walk(ast.parse(path.read_text("utf-8"))))
        inner = {id(part) for node in nodes if isinstance(node, ast.JoinedStr)
                 for part in node.values}  # fmt: skip
        docs = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
        for node in nodes:
            if id(node) in inner | docs:
                continue
            if isinstance(node, ast.JoinedStr):
                parts = (v.value if isinstance(v, ast.Constant) else "x" for v in node.values)
                yield path.name, "".join(parts)
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield path.name, node.value


@cache
def mentions():
    """Return every command with its arguments that a message names, and its file.

    It is computed on demand: reading the whole program takes seconds, which each process that
    only collects the tests would pay as well.
    """
    return sorted(
        {
            (file, found[1], found[2])
            for file, text in sentences()
            for found in COMMAND.finditer(text)
            if found[1] not in PROSE and not text.startswith("ikservo ")  # a thread's name
        }
    )


def full_name(name, arguments):
    """Return the name of a command together with that of its sub-command."""
    longer = " ".join([name, *arguments.split()[:1]])
    return longer if longer in all_commands() else name


def command_of(name):
    import typer

    return typer.main.get_command(app).get_command(None, name)


@pytest.mark.full
def test_commands_quoted_in_messages_exist():
    assert [(file, name) for file, name, _ in mentions() if name not in all_commands()] == []


@pytest.mark.full
def test_options_of_commands_quoted_in_messages_exist():
    wrong = []
    for file, name, arguments in mentions():
        if name == "sim":  # which passes its options to the simulator
            continue
        params = command_of(full_name(name, arguments)).params
        options = {text for param in params for text in param.opts}
        named = {word.partition("=")[0] for word in arguments.split() if word.startswith("--")}
        wrong += [(file, name, option) for option in named - options - {"--help"}]
    assert wrong == []


@pytest.mark.full
def test_command_quoted_in_hint_excludes_following_prose():
    prose = {"tries", "is", "and", "then", "the", "to", "goes", "with", "for"}
    assert [row for row in mentions() if prose & set(row[2].split())] == []


def test_hint_repeats_arm_and_port_of_a_calibration_command():
    hint = "Finish it: ikservo calibration resume. Or go back: ikservo calibration revert."
    result = with_connection_options(hint, ["calibrate", "so101", "--port", "/dev/ttyACM0"])
    assert result == (
        "Finish it: ikservo calibration resume so101 --port /dev/ttyACM0. "
        "Or go back: ikservo calibration revert so101 --port /dev/ttyACM0."
    )


def test_hint_repeats_positional_arm_name_of_command():
    words = ["identify", "so101", "--port", "sim"]
    result = with_connection_options("Switch torque off with: ikservo relax", words)
    assert result == "Switch torque off with: ikservo relax --arm so101 --port sim"
