"""Only text that is typed after a question answers it."""

import os
import re
import select
import sys
from pathlib import Path

import pytest
import typer

import ikservo.cli
from ikservo.cli.open_and_confirm import confirm_motion
from ikservo.cli.terminal import confirm, read_keys, wait_for_enter

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no ptys")


class Terminal:
    """The keyboard of the terminal that is stdin; types the next text after each prompt."""

    def __init__(self, keyboard):
        self.keyboard, self.texts = keyboard, []

    def type(self, text):
        os.write(self.keyboard, text.encode())
        select.select([sys.stdin], [], [], 0.2)  # the kernel carries it over when it has time

    def print(self, prompt, **how):
        print(prompt, **how)  # noqa: T201
        if self.texts and how.get("end") == " ":  # a prompt
            self.type(self.texts.pop(0))


@pytest.fixture
def terminal(monkeypatch):
    master, slave = os.openpty()
    stdin = os.fdopen(slave, "r")
    terminal = Terminal(master)
    monkeypatch.setattr(sys, "stdin", stdin)
    monkeypatch.setattr("ikservo.cli.terminal.print", terminal.print, raising=False)
    yield terminal
    stdin.close()
    os.close(master)


@pytest.mark.parametrize("ahead", ["y\n", "y\ny\ny\n", "\n\n\n", "y"])
def test_prompt_ignores_text_typed_before_it(terminal, ahead):
    terminal.type(ahead)
    terminal.texts = ["n\n"]
    assert confirm("Switch torque off?") is False


def test_prompt_ignores_second_line_typed_for_previous_one(terminal):
    terminal.texts = ["y\ny\n", "n\n"]
    assert [confirm("Save?"), confirm("Write the limits?")] == [True, False]


@pytest.mark.parametrize("text", ["\n", "   \n", "maybe\n", "yn\n"])
def test_prompt_requires_explicit_answer(terminal, capsys, text):
    terminal.texts = [text, "y\n"]
    assert confirm("Move?") is True
    assert capsys.readouterr().err == "Move? [y/n]: Type y or n, then Enter.\nMove? [y/n]: "


@pytest.mark.parametrize(("text", "answer"), [("YES\n", True), (" No \n", False)])
def test_prompt_accepts_yes_and_no_written_out(terminal, text, answer):
    terminal.texts = [text]
    assert confirm("Move?") is answer


def test_wait_for_enter_ignores_enter_typed_before_it(terminal):
    terminal.type("\n")
    terminal.texts = ["\x04"]  # Ctrl-D: nothing else is waiting
    with pytest.raises(typer.Abort):
        wait_for_enter("Move the arm to the pose, then press Enter.")


def test_motion_prompt_ignores_enter_typed_before_it(terminal):
    class Machine:
        zeros = None

    terminal.type("\ny\n")
    terminal.texts = ["n\n"]
    with pytest.raises(Exception, match="nothing moved"):
        confirm_motion(Machine(), yes=False)


def test_read_keys_ignores_keys_typed_before_it(terminal):
    terminal.type("us\n")
    with read_keys() as pressed:
        assert pressed() == ""


def test_read_keys_returns_every_key_of_a_burst_once(terminal):
    with read_keys() as pressed:
        terminal.type("us")
        assert pressed() == "us"
        assert pressed() == ""


def test_read_keys_ignores_arrow_and_other_escape_sequences(terminal):
    with read_keys() as pressed:
        terminal.type("\x1b[A\x1bOB\x1b[1;5Cs")
        assert pressed() == "s"


def test_prompt_ignores_keys_left_unread_by_key_reader(terminal):
    with read_keys():
        terminal.type("y\n")
    terminal.texts = ["n\n"]
    assert confirm("Save?") is False


def test_only_the_terminal_module_reads_prompts():
    elsewhere = re.compile(r"typer\.(confirm|prompt)|\binput\(|stdin\.read")
    sources = Path(ikservo.cli.__file__).parent.rglob("*.py")
    found = [path.name for path in sources if elsewhere.search(path.read_text("utf-8"))]
    assert found == ["terminal.py"]  # which reads lines itself where there are no descriptors
