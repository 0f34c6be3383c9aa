"""The output of every reporting command on a terminal of 80 columns."""

import io
import re

import pytest

from ikservo.cli import main
from ikservo.cli.command_group import all_commands
from ikservo.cli.terminal import fold
from tests.cli.fixtures_ports import PortInfo, set_ports

SIM = "--port sim:?pose=home"
REPORTS = [
    "arms",
    "ports",
    f"scan --arm wx250s {SIM}",
    f"doctor --arm vx300s {SIM}",
    f"where --arm so101 {SIM}",
    f"where --arm vx300s {SIM}",
    f"where --arm open_manipulator_x {SIM} --watch --count 1",
    f"move 0.22 0.02 0.12 --arm so101 {SIM} --dry-run",
    f"move 9 9 9 --arm so101 {SIM}",
    f"joints wrist_flex=10 --arm so101 {SIM}",
    f"jog shoulder_pan --duration 100ms --arm so101 {SIM}",
    f"gripper close --arm so101 {SIM}",
    f"stop --arm so101 {SIM}",
    f"recover --arm wx250s {SIM}",
    "solve 0.25 0.05 0.15 --arm wx250s",
    "solve 0.25 0.05 0.15 --arm px100 --all",
    "solve 0.25 0.05 0.15 --arm so101 --compare",
    "workspace --arm so101 --point 0.9 0 0.1",
    f"bench bus --arm so101 {SIM} --count 10",
]


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture
def shown(monkeypatch, tmp_path):
    """Return the visible output of a command, without a terminal or on one of the given width."""
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    monkeypatch.setattr("ikservo.apps.workbench.doctor.READS", 60)
    port = PortInfo("/dev/ttyACM0", serial_number="58FA083")
    set_ports(monkeypatch, [port])

    def run(words, columns=None):
        out = io.StringIO() if columns is None else Terminal()
        monkeypatch.setenv("COLUMNS", str(columns or 80))
        monkeypatch.setenv("TERM", "dumb")
        with monkeypatch.context() as patch:
            patch.setattr("sys.stdout", out)
            patch.setattr("sys.stderr", out)
            main(words.split())
        return re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", out.getvalue()).replace("\r", "\n")

    return run


def too_long(text):
    return [line for line in text.splitlines() if len(line) > 80 and " " in line.strip()]


def names(text):
    """Return the words of a text without those with numbers, which differ between runs."""
    return {word for word in text.split() if not re.search(r"[\d●├┤─…]", word)}


@pytest.mark.sample(5)
@pytest.mark.parametrize("words", REPORTS)
def test_report_rows_fit_80_columns_and_do_not_break_words(shown, words):
    narrow = shown(words, 80)
    assert narrow.strip()
    assert too_long(narrow) == []
    if "--watch" not in words and "bench" not in words:
        assert names(narrow) <= names(shown(words))


@pytest.mark.parametrize("word", sorted(set(all_commands()) - {"sim"}))
def test_help_fits_80_columns(shown, word):
    assert too_long(shown(f"{word} --help", 80)) == []


def test_command_in_wrapped_message_stays_on_one_line():
    assert fold("Nothing answers here. Then type: ikservo where --arm so101", 44) == [
        "Nothing answers here. Then type:",
        "ikservo where --arm so101",
    ]


def test_wrapped_table_line_keeps_its_column_spacing():
    assert fold("✗ port      a long reason for it", 20, 12) == [
        "✗ port      a long",
        "            reason",
        "            for it",
    ]


def test_wrapping_does_not_split_word_longer_than_line():
    assert fold("see /a/path/that/is/long now", 12) == ["see", "/a/path/that/is/long", "now"]


def test_arms_table_heading_is_one_line_at_80_columns(shown):
    assert shown("arms", 80).splitlines()[0].split() == ["name", "arm", "joints", "servos"]
