"""A failure put into one line of the stream's loop, wherever that is."""

import dis
import sys
from collections import Counter

from ikservo.arm.streaming import feedback, health_round, servos, setpoints, stream, throttle
from ikservo.guard import following, gate, look_ahead

_LOOP = [
    stream.Stream._stream,
    stream.Stream._told,
    throttle.Throttle.step,
    setpoints.Setpoints.next,
    throttle.Throttle._count,
    servos.Servos.beat,
    servos.Servos._heard,
    servos.Servos.advance_s,
    servos.Servos.command,
    servos.Servos.goals,
    servos.Servos._ticks,
    servos.Servos._positions,
    feedback.Feedback.beat,
    feedback.Feedback._note,
    feedback.Feedback._positions,
    health_round.HealthRound.beat,
    health_round.HealthRound._ask,
    following.Following.see,
    gate.Gate.see,
    gate.Gate.cut,
    gate.Gate._share,
    gate.Gate.send,
    gate.Gate.advance_s,
    look_ahead.LookAhead.see,
    look_ahead.LookAhead.check,
]


def loop_lines():
    """Return (file, line) of every line of the loop."""
    return [
        (function.__code__.co_filename, number)
        for function in _LOOP
        for number in sorted({n for _, n in dis.findlinestarts(function.__code__) if n})
    ]


class Traced:
    """While this is in force, lines of the loop are counted, and one of them may fail.

    Args:
        fails: The (file, line) that raises ``ZeroDivisionError``; None for none.
        at: The how-manieth time.
    """

    def __init__(self, fails=None, at=1):
        self._fails, self._at = fails, at
        self._files = {file for file, _ in loop_lines()}
        self.hits = Counter()

    def __enter__(self):
        sys.settrace(self._call)
        return self

    def __exit__(self, *_):
        sys.settrace(None)

    def _call(self, frame, event, arg):
        return self._line if frame.f_code.co_filename in self._files else None

    def _line(self, frame, event, arg):
        if event == "line":
            place = frame.f_code.co_filename, frame.f_lineno
            self.hits[place] += 1
            if place == self._fails and self.hits[place] == self._at:
                raise ZeroDivisionError(f"line {frame.f_lineno} failed")
        return self._line
