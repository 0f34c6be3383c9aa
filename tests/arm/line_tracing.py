"""Pauses and failures before any line of the program that runs while an arm moves.

No function is named: the lines are those that Python executes in the traced packages.
"""

import sys
from collections import Counter
from pathlib import Path

from ikservo import control, guard, hardware, motion

LOOP = (control, guard, motion)
LOOP_AND_PORT = (*LOOP, hardware)


class LineTracer:
    """Counts the executed lines of some packages while it is active.

    Counting begins with `begin`, so that code before the first control cycle is left out.

    Args:
        packages: The packages whose modules are traced.

    Attributes:
        hits: Number of executions of each (file, line number).
    """

    def __init__(self, packages=LOOP):
        self._files = source_files(packages)
        self._is_counting = False
        self.hits = Counter()

    def begin(self, *_):
        """Start to count; this is the callback of each cycle, and only the first call counts."""
        if not self._is_counting:
            self._is_counting = True
            self.hits.clear()

    def before_line(self, place, count):
        """Act before a line is executed for the nth time; only count in this class."""

    def lines_of_a_cycle(self, min_hits=20):
        """Return each (file, line) that runs in most cycles, and its count, sorted."""
        return sorted((place, hits) for place, hits in self.hits.items() if hits > min_hits)

    def __enter__(self):
        sys.settrace(self._on_call)
        return self

    def __exit__(self, *_):
        sys.settrace(None)

    def _on_call(self, frame, _event, _arg):
        return self._on_line if frame.f_code.co_filename in self._files else None

    def _on_line(self, frame, event, _arg):
        if event == "line" and self._is_counting:
            place = frame.f_code.co_filename, frame.f_lineno
            self.hits[place] += 1
            self.before_line(place, self.hits[place])
        return self._on_line


class FailingLine(LineTracer):
    """Raises ``ZeroDivisionError`` before a line is executed for the nth time.

    Args:
        place: The (file, line number) that fails.
        count: The number of the execution, from 1.
        packages: The packages whose modules are traced.
    """

    def __init__(self, place, count, packages=LOOP):
        super().__init__(packages)
        self._files &= {place[0]}  # tracing other files only takes time
        self._place, self._count = place, count

    def before_line(self, place, count):
        if place == self._place and count == self._count:
            raise ZeroDivisionError(f"line {place[1]} failed")


class PausedLines(LineTracer):
    """Lets virtual time pass before some lines, like a busy machine that runs another program.

    Args:
        clock: The virtual clock of the simulated bus.
        pause_s: Called with each (file, line number) and its number of executions; returns the
            pause before that line.
        packages: The packages whose modules are traced.
        files: If given, pauses happen only in these files.

    Attributes:
        pauses: Number of pauses.
    """

    def __init__(self, clock, pause_s, packages=LOOP_AND_PORT, files=None):
        super().__init__(packages)
        if files is not None:
            self._files &= files
        self._clock, self._pause_s = clock, pause_s
        self.pauses = 0

    def before_line(self, place, count):
        pause_s = self._pause_s(place, count)
        if pause_s:
            self.pauses += 1
            self._clock.sleep_until(self._clock.now_s() + pause_s)


def source_files(packages):
    """Return the file names of all modules of some packages."""
    folders = [Path(package.__file__).parent for package in packages]
    return {str(path) for folder in folders for path in folder.rglob("*.py")}
