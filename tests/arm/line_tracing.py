"""Pauses and failures between any two lines of the program that run while an arm moves.

No function is named: the lines are those that Python executes in the traced packages.
"""

import sys
from collections import Counter
from pathlib import Path

from ikservo import control, guard, hardware, motion

LOOP = (control, guard, motion)
LOOP_AND_PORT = (*LOOP, hardware)


class LineTracer:
    """While this is in force, the lines that are executed in some packages are counted.

    Counting begins with `begin`, so that what runs before the first control cycle is left out.

    Args:
        packages: Their modules are traced.

    Attributes:
        hits: How often each (file, line number) was reached.
    """

    def __init__(self, packages=LOOP):
        self._files = source_files(packages)
        self._is_counting = False
        self.hits = Counter()

    def begin(self, *_):
        """Count from here on; made to be the callback of each cycle, of which the first counts."""
        if not self._is_counting:
            self._is_counting = True
            self.hits.clear()

    def before_line(self, place, count):
        """Do something before a line is executed for the nth time; counts only here."""

    def lines_of_a_cycle(self, min_hits=20):
        """Return each (file, line) that is executed in most cycles, and how often, sorted."""
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
        count: The nth time, from 1.
        packages: Their modules are traced.
    """

    def __init__(self, place, count, packages=LOOP):
        super().__init__(packages)
        self._files &= {place[0]}  # tracing other files only takes time
        self._place, self._count = place, count

    def before_line(self, place, count):
        if place == self._place and count == self._count:
            raise ZeroDivisionError(f"line {place[1]} failed")


class PausedLines(LineTracer):
    """Lets virtual time pass before some lines, as where a busy machine runs another program.

    Args:
        clock: The virtual clock of the simulated bus.
        pause_s: Called with each (file, line number) and how often it was reached; returns how
            long the program pauses before that line.
        packages: Their modules are traced.
        files: Only these of them are, where pauses come nowhere else.

    Attributes:
        pauses: How often the program was paused.
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
