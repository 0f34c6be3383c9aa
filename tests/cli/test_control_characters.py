"""Control characters of files and of the network are spelled out before a terminal sees them."""

import json

import pytest

from ikservo.cli.entry_point import main
from ikservo.cli.terminal import print_json, print_lines, print_status, print_table, printable
from ikservo.errors import IkservoError

HOSTILE = "a\x1b[2Jb\rc\x07\x9b31m\x7f\u202ed"
SHOWN = r"a\x1b[2Jb\rc\x07\x9b31m\x7f\u202ed"


def test_printable_text_keeps_lines_tabs_and_letters():
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
def test_text_output_has_no_control_characters(capsys, show):
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
