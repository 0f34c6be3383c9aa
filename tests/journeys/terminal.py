"""A terminal with a person in front of it, who types, reads the screen and waits for words."""

import contextlib
import fcntl
import os
import pty
import re
import select
import signal
import struct
import sys
import termios
import threading
import time
from dataclasses import dataclass, field

import pyte

IKSERVO = [sys.executable, "-c", "from ikservo.cli import console; console()"]
CONTROLS = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]|\x1b[()][A-Z0-9]|\x1b[=>]")
ROWS = 50
SOON_S = 40.0  # long enough for a busy machine


@dataclass
class Ended:
    """The output of a command that has ended.

    Attributes:
        code: Its exit code; minus the signal that ended it.
        text: All that it printed, without colours and control sequences.
        screen: The lines that are on the screen at the end.
        long: The printed lines that are longer than the width of the screen.
    """

    code: int
    text: str
    screen: list
    long: list


@dataclass
class Terminal:
    """A screen of the given width, and the environment of the shell in it."""

    columns: int = 80
    env: dict = field(default_factory=dict)

    @contextlib.contextmanager
    def running(self, *words):
        """Run ``ikservo`` with these words; yield the program, which is killed at the end."""
        program = Program(self, [*IKSERVO, *map(str, words)])
        try:
            yield program
        finally:
            program.kill()

    def run(self, *words, typed=()):
        """Run a command to its end and return its output; ``typed`` is (words, answer) pairs."""
        with self.running(*words) as program:
            for question, answer in typed:
                program.wait_for(question)
                program.type(answer)
            return program.ended()


class Program:
    """A command that runs in a terminal, which reads its output at once, as terminals do.

    A program whose output is not read would have to wait, and could not read servos meanwhile.
    """

    def __init__(self, terminal, argv):
        self._columns = terminal.columns
        self._screen = pyte.Screen(terminal.columns, ROWS)
        self._stream, self.raw, self._read_to = pyte.ByteStream(self._screen), b"", 0
        self._pid, self._fd = pty.fork()
        if self._pid == 0:
            env = {**os.environ, "TERM": "xterm-256color", **terminal.env}
            for name in ("COLUMNS", "LINES", "NO_COLOR"):
                env.pop(name, None)
            time.sleep(0.05)  # until the screen has its size
            os.execvpe(argv[0], argv, env)
        self.resize(terminal.columns)
        self._news, self._unread, self._open = threading.Condition(), b"", True
        self._reader = threading.Thread(target=self._take_all, daemon=True)
        self._reader.start()

    def _take_all(self):
        """Read the output until the program closes it."""
        while self._open:
            ready, _, _ = select.select([self._fd], [], [], 0.1)
            data = self._taken() if ready else b""
            with self._news:
                self._unread += data
                self._open = self._open and (bool(data) or not ready)
                self._news.notify()

    def _taken(self):
        try:
            return os.read(self._fd, 65536)
        except OSError:  # the last program in it has ended
            return b""

    def resize(self, columns):
        """Resize the terminal to another width."""
        fcntl.ioctl(self._fd, termios.TIOCSWINSZ, struct.pack("HHHH", ROWS, columns, 0, 0))
        self._screen.resize(ROWS, columns)

    @property
    def text(self):
        """Return all output, without colours and control sequences."""
        return CONTROLS.sub("", self.raw.decode(errors="replace")).replace("\r\n", "\n")

    def type(self, text):
        """Press keys; "\\x03" is Ctrl-C."""
        os.write(self._fd, text.encode())

    def wait_for(self, words, within_s=SOON_S):
        """Wait for words in new output, whatever their line breaks."""
        return self.wait_for_any(words, within_s=within_s)

    def wait_for_any(self, *choices, within_s=SOON_S):
        """Wait for the first of several words in new output; return them without line breaks."""
        pattern = re.compile("|".join(map(_loosely, choices)), re.IGNORECASE)
        until_s = time.monotonic() + within_s
        while True:
            match = pattern.search(self.text, self._read_to)
            if match:
                self._read_to = match.end()
                return " ".join(match.group().split())
            alive = self.pump(0.1)
            if time.monotonic() > until_s or not alive:
                message = f"{choices} was not printed; the screen:\n" + "\n".join(self.lines())
                raise AssertionError(message)

    def wait_until(self, seen, within_s=SOON_S):
        """Wait until something holds for the lines on the screen."""
        until_s = time.monotonic() + within_s
        while not seen(self.lines()):
            alive = self.pump(0.1)
            assert alive, "it has ended; the screen:\n" + "\n".join(self.lines())
            assert time.monotonic() < until_s, "the screen stays:\n" + "\n".join(self.lines())

    def lines(self):
        """Return the lines on the screen, without empty ones at its end."""
        lines = [line.rstrip() for line in self._screen.display]
        while lines and not lines[-1]:
            lines.pop()
        return lines

    def signal(self, number):
        os.kill(self._pid, number)

    def ended(self, within_s=SOON_S):
        """Wait for the end and return the output."""
        until_s = time.monotonic() + within_s
        while self.pump(0.1):
            assert time.monotonic() < until_s, "it does not end; the screen:\n" + self.text[-3000:]
        _, status = os.waitpid(self._pid, 0)
        self._pid = 0
        long = [line for line in self._printed() if len(line) > self._columns]
        return Ended(os.waitstatus_to_exitcode(status), self.text, self.lines(), long)

    def kill(self):
        if self._pid:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self._pid, signal.SIGKILL)
            os.waitpid(self._pid, 0)
        self._pid, self._open = 0, False
        self._reader.join()
        os.close(self._fd)

    def _printed(self):
        """Yield printed lines, the last version of a redrawn one; a path may be long."""
        for line in self.text.split("\n"):
            last = line.rstrip("\r").rpartition("\r")[2].rstrip()
            if not any(len(word) > self._columns // 2 for word in last.split()):
                yield last

    def pump(self, wait_s=0.1):
        """Read new output, or wait for it; return whether the program still runs."""
        with self._news:
            if self._open and not self._unread:
                self._news.wait(wait_s)
            data, self._unread = self._unread, b""
            runs = self._open or bool(data)
        self.raw += data
        self._stream.feed(data)
        return runs


def _loosely(words):
    """Return a pattern of words with anything between them that a wrapped line may have.

    ``#`` stands for any number.
    """
    escaped = (re.escape(word).replace(r"\#", r"[-+]?[\d.]+") for word in words.split())
    return r"[\s│]+".join(escaped)
