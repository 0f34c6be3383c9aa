"""Control characters in files and network data are escaped before a terminal receives them."""

import json
import re
import sys
from pathlib import Path

import pytest
from rich.console import Group
from rich.table import Table
from rich.text import Text

import ikservo
from ikservo.cli.entry_point import main
from ikservo.cli.terminal import (
    open_console,
    print_json,
    print_lines,
    print_status,
    print_table,
    print_text,
    printable,
)
from ikservo.errors import IkservoError

PACKAGE = Path(ikservo.__file__).parent
HOSTILE = "a\x1b[2Jb\rc\x07\x9b31m\x7f\u202ed"
SHOWN = r"a\x1b[2Jb\rc\x07\x9b31m\x7f\u202ed"


def test_output_filter_keeps_newlines_tabs_and_letters():
    assert printable("Größe\t0,5 µm →\n日本") == "Größe\t0,5 µm →\n日本"
    assert printable(HOSTILE) == SHOWN


@pytest.mark.parametrize(
    "show",
    [
        print_status,
        lambda text: print_lines([text]),
        lambda text: print_table(["name"], [[text]]),
    ],
    ids=["status", "lines", "table"],
)
def test_command_text_output_has_no_control_characters(capsys, show):
    show(HOSTILE)
    out, err = capsys.readouterr()
    assert SHOWN in out + err
    assert not set(HOSTILE) - set("a[2Jbc31md") & set(out + err)


def test_json_output_has_no_control_characters_and_same_value(capsys):
    print_json("test", text=HOSTILE, name="Größe")
    out = capsys.readouterr().out
    assert json.loads(out)["text"] == HOSTILE
    assert out.strip().isprintable()
    assert "Größe" in out


def test_error_message_has_no_control_characters(capsys, monkeypatch):
    def fail(_):
        raise IkservoError(f"Stopped: {HOSTILE}", HOSTILE)

    monkeypatch.setattr("ikservo.cli.entry_point._run_command", fail)
    assert main(["where", "--json"]) == 1
    out, err = capsys.readouterr()
    assert json.loads(out)["hint"] == HOSTILE
    assert (out + err).replace("\n", "").isprintable()


def test_live_terminal_displays_show_no_control_characters(monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    console = open_console()
    table = Table()
    table.add_column("name")
    table.add_row(Text("cup\x1b[2J\x07", "red"))
    with console.capture() as capture:
        console.print(Group("tip\x1b]0;title\x07\u202e", table))
    shown = capture.get()
    assert "cup\\x1" in shown  # cut at the width of its column
    assert not re.search("\x1b(?!\\[[0-9;]*m)|\x07|\u202e", shown)


@pytest.mark.parametrize("is_terminal", [True, False])
def test_export_hides_control_characters_only_on_terminal(monkeypatch, capsys, is_terminal):
    monkeypatch.setattr(sys.stdout, "isatty", lambda: is_terminal, raising=False)
    print_text("time_s,cup\x1b[2J\n")
    assert ("\x1b" in capsys.readouterr().out) is not is_terminal


def test_only_the_terminal_module_writes_to_the_terminal():
    """Only the terminal module creates Rich consoles and writes raw text."""
    written = re.compile(r"\bConsole\(|rich\.print|typer\.echo\((?!__version__)|sys\.stdout\.write")
    files = [f for f in PACKAGE.rglob("*.py") if written.search(f.read_text())]
    assert [f.relative_to(PACKAGE).as_posix() for f in files] == ["cli/terminal.py"]
