"""A program that is held up between two lines of its control cycle: virtual time goes on."""

import sys
from collections import Counter
from pathlib import Path

import ikservo

PRODUCT = Path(ikservo.__file__).parent
FOLDERS = ("arm/streaming", "guard", "motion", "hardware")
FILES = {str(path) for folder in FOLDERS for path in (PRODUCT / folder).rglob("*.py")}


class HeldUp:
    """While this is in force, the program is held up before some of the lines that it runs.

    Args:
        clock: The virtual clock of the line.
        pause_s: Called with each (file, line) and how often it was reached; returns for how long
            the program is held up there.

    Attributes:
        hits: How often each (file, line) was reached.
        pauses: How often the program was held up.
    """

    def __init__(self, clock, pause_s):
        self._clock, self._pause_s = clock, pause_s
        self.hits, self.pauses, self.begun = Counter(), 0, False

    def begin(self, _beat):
        """Count from here on: called at each beat, it begins with the first."""
        if not self.begun:
            self.begun = True
            self.hits.clear()

    def __enter__(self):
        sys.settrace(self._call)
        return self

    def __exit__(self, *_):
        sys.settrace(None)

    def _call(self, frame, event, arg):
        return self._line if frame.f_code.co_filename in FILES else None

    def _line(self, frame, event, arg):
        if event == "line" and self.begun:
            place = frame.f_code.co_filename, frame.f_lineno
            self.hits[place] += 1
            pause_s = self._pause_s(place, self.hits[place])
            if pause_s:
                self.pauses += 1
                self._clock.sleep_until(self._clock.now_s() + pause_s)
        return self._line
