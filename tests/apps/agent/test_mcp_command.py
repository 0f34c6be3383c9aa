"""`ikservo mcp`: options that contradict the arm, missing packages, and the journal."""

import os

import pytest

from tests.cli.conftest import run_cli

__all__ = ["run_cli"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("--allow slow", "--allow slow needs a region"),
        ("--allow everything", "everything"),
        ("--budget 0", "--budget"),
        ("--http-port 0 --listen nowhere", "--listen is nowhere"),
    ],
)
def test_mcp_command_refuses_invalid_options_before_motion(run_cli, options, words):
    done = run_cli(f"mcp so101 --port sim {options}")
    assert done.code == 2
    assert words in done.err


def test_mcp_command_without_package_names_install_command(run_cli, monkeypatch):
    monkeypatch.setattr("ikservo.apps.agent.mcp_command.find_spec", lambda _: None)
    done = run_cli("mcp so101 --port sim")
    assert done.code == 2
    assert "[agent]" in done.err


def test_approve_command_without_server_says_what_to_start(run_cli):
    done = run_cli("mcp --approve")
    assert done.code == 2
    assert "Start `ikservo mcp` first" in done.err


def test_damaged_agent_journal_error_names_line(run_cli, tmp_path):
    file = tmp_path / "journal.jsonl"
    file.write_text('{"time": "2026-01-01T00:00:00.000", "event": "done", "plan": "a\\u001b"}\nx\n')
    done = run_cli(f"mcp --replay --journal {file}")
    assert done.code == 2
    assert "line 2" in done.err
    assert "\x1b" not in done.out


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes with a name")
def test_agent_journal_that_is_a_pipe_is_refused_at_once(run_cli, tmp_path):
    os.mkfifo(tmp_path / "journal.jsonl")
    done = run_cli(f"mcp --replay --journal {tmp_path / 'journal.jsonl'}")
    assert done.code == 2
    assert "journal.jsonl" in done.err
