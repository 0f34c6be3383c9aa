"""A failure put into one line of the stream's loop, wherever that is."""

import dis
import sys
from collections import Counter

from ikservo.control import feedback
from ikservo.control import health_polling as health_round
from ikservo.control import loop as setpoints
from ikservo.control import loop as stream
from ikservo.control import loop as throttle
from ikservo.control import servo_group as servos
from ikservo.guard import gate
from ikservo.guard import limits as look_ahead
from ikservo.guard import monitors as following

_LOOP = [
    stream.ControlLoop._run_loop,
    stream.ControlLoop._make_cycle,
    throttle.TimeScaler.step,
    setpoints.SetpointSampler.next_setpoint,
    throttle.TimeScaler._count_late_cycles,
    servos.ServoGroup.update,
    servos.ServoGroup._update_measured,
    servos.ServoGroup.allowed_advance_s,
    servos.ServoGroup.send_goals,
    servos.ServoGroup.goals,
    servos.ServoGroup._to_ticks,
    servos.ServoGroup._to_positions,
    feedback.Feedback.read,
    feedback.Feedback._store_ticks,
    feedback.Feedback._latest_positions,
    health_round.HealthPoller.poll,
    health_round.HealthPoller._read_registers,
    following.TrackingMonitor.update,
    gate.Gate.update_measured,
    gate.Gate.shorten_goals,
    gate.Gate._step_fraction,
    gate.Gate.send,
    gate.Gate.allowed_advance_s,
    look_ahead.LeadLimiter.update_measured,
    look_ahead.LeadLimiter.check_lead,
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
