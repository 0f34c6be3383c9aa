"""A command that Ctrl-C stopped ends by that signal, so that a shell's loop around it ends."""

import shlex
import shutil
import signal
import subprocess
import sys

import pytest

from ikservo.cli import entry_point
from ikservo.errors import StoppedError
from ikservo.files.writing import FileWriteError

posix = pytest.mark.skipif(sys.platform == "win32", reason="no process ends by a signal there")
WAITING = [sys.executable, "-c", "from ikservo.cli import console; console()", "ports", "--watch"]


def ended_after(monkeypatch, *errors):
    """Return how a command ends that raises errors, each while the one before is handled."""

    def fail(_):
        before = None
        for error in errors:
            error.__context__ = before
            before = error
        raise before

    monkeypatch.setattr(entry_point, "_run_command", fail)
    return entry_point._run_and_report(["move"])


@posix
def test_ctrl_c_ends_process_by_sigint_after_last_message():
    with subprocess.Popen(WAITING, stdout=-1, stderr=subprocess.PIPE, text=True) as process:
        process.stderr.readline()
        process.send_signal(signal.SIGINT)
        _, result = process.communicate(timeout=60)
    assert process.returncode == -signal.SIGINT
    assert result.endswith("Stopped.\n")


@posix
@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
def test_ctrl_c_ends_a_shell_loop_over_commands():
    from tests.journeys.terminal import Program, Terminal

    command = shlex.join(WAITING)
    program = Program(Terminal(), ["bash", "-c", f"for i in 1 2; do {command}; echo next; done"])
    try:
        program.wait_for("Ctrl-C ends")
        program.type("\x03")
        ended = program.ended()
    finally:
        program.kill()
    assert ended.code == -signal.SIGINT
    assert "next" not in ended.text


def test_ctrl_c_before_stop_error_counts_as_interrupt(monkeypatch):
    ended = ended_after(monkeypatch, KeyboardInterrupt(), StoppedError("Stopped; torque is off."))
    assert (ended.code, ended.interrupted) == (130, True)


@pytest.mark.parametrize(
    "errors",
    [
        [StoppedError("Stopped from another terminal; torque stays on.")],
        [SystemExit(143), StoppedError("Stopped by SIGTERM; torque stays on.")],
        [EOFError(), KeyboardInterrupt()],  # the end of the input at a question
    ],
)
def test_stopped_error_without_ctrl_c_exits_with_130(monkeypatch, errors):
    ended = ended_after(monkeypatch, *errors)
    assert (ended.code, ended.interrupted) == (130, False)


def test_failure_after_ctrl_c_keeps_its_exit_code(monkeypatch):
    ended = ended_after(monkeypatch, KeyboardInterrupt(), FileWriteError("wave.jsonl", "full"))
    assert (ended.code, ended.interrupted) == (1, False)


def test_ctrl_c_on_windows_exits_with_130(monkeypatch):
    codes = []
    monkeypatch.setattr(sys, "platform", "win32")
    outcome = entry_point._Outcome(130, interrupted=True)
    monkeypatch.setattr(entry_point, "_run_and_report", lambda _: outcome)
    monkeypatch.setattr("os._exit", codes.append)
    entry_point.console()
    assert codes == [130]
