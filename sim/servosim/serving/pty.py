"""The same line behind a pseudo-terminal, in real time, for anybody's software."""

from __future__ import annotations

import errno
import os
import select
import time
import tty
from collections.abc import Sequence
from pathlib import Path

from servosim.line import Line
from servosim.serving.link import point_link, remove_link
from servosim.serving.termios2 import line_speed

__all__ = ["PtyBus"]

SPIN_S = 100e-6  # the kernel wakes us about this late: the rest is waited for awake
AWAKE_STEP_S = 0.002  # a world in motion is kept up to date in small steps
DOZING_STEP_S = 0.050
NOBODY_STEP_S = 0.010  # between two looks whether somebody has opened the terminal


class PtyBus:
    """A pseudo-terminal whose master end is the line.

    Answers are written at the moment at which their last byte is due: the simulator's own work
    hides in the time that the bytes take. Nobody holds the slave end but the client, so that
    exclusive opening and hanging up work as on a real port.

    Attributes:
        path: The slave's device file.
        link: A symbolic link to it, or None.
        follow_baud: Whether the line goes at the rate that the client has set.
    """

    def __init__(self, line: Line, link: Path | None = None) -> None:
        self.line, self.link = line, link
        self.follow_baud = True
        self._start_s = time.monotonic()
        self._master = -1
        self.path = Path()
        self.plug()

    def plug(self) -> None:
        """Open a new pseudo-terminal and point the link at it."""
        self._master, slave = os.openpty()
        tty.setraw(slave)
        self.path = Path(os.ttyname(slave))
        os.close(slave)
        os.set_blocking(self._master, False)
        if self.link is not None:
            point_link(self.link, self.path)

    def unplug(self) -> None:
        """Close the terminal: the client sees what a pulled USB cable gives."""
        if self._master >= 0:
            os.close(self._master)
            self._master = -1
        if self.link is not None:
            remove_link(self.link, self.path)

    def now_s(self) -> float:
        """Return the line's time: real seconds since the start."""
        return time.monotonic() - self._start_s

    def work(self, also: Sequence[int] = ()) -> list[int]:
        """Do what is due and wait for more; return those of ``also`` that can be read."""
        self._follow_cable()
        due_s = self._next_due_s()
        ready = self._wait(due_s, also)
        if self._master in ready:
            self._receive()
        else:
            self.line.run_until(self.now_s())
        self._send()
        return [fd for fd in ready if fd != self._master]

    def _next_due_s(self) -> float:
        now_s = self.now_s()
        idle_s = DOZING_STEP_S if self.line.world.dozing else AWAKE_STEP_S
        due = [now_s + idle_s, self.line.next_s, self.line.inbox.next_end_s()]
        return min(at_s for at_s in due if at_s is not None)

    def _follow_cable(self) -> None:
        """A fault may pull the cable and plug it in again."""
        if self.line.plugged and self._master < 0:
            self.plug()
        elif not self.line.plugged and self._master >= 0:
            self.unplug()

    def _wait(self, due_s: float, also: Sequence[int]) -> list[int]:
        watched = [fd for fd in (self._master, *also) if fd >= 0]
        sleep_s = max(0.0, due_s - self.now_s() - SPIN_S)
        ready = select.select(watched, [], [], sleep_s)[0]
        while not ready and self.now_s() < due_s:
            pass
        return ready

    def _receive(self) -> None:
        data = self._read()
        if not data:
            return
        now_s = self.now_s()
        if self.follow_baud:
            self.line.set_baud(line_speed(self._master) or self.line.baud)
        self.line.host_write(data, now_s)
        self.line.run_until(self.line.heard_all_s)

    def _read(self) -> bytes:
        try:
            return os.read(self._master, 4096)
        except BlockingIOError:
            return b""
        except OSError as error:
            if error.errno != errno.EIO:
                raise
            self._nobody_there()
            return b""

    def _nobody_there(self) -> None:
        """No client has the terminal open: forget its answers and look again a little later."""
        time.sleep(NOBODY_STEP_S)
        now_s, world = self.now_s(), self.line.world
        if not world.dozing or now_s - world.time_s > DOZING_STEP_S:
            self.line.run_until(now_s)
        self.line.inbox.clear(now_s)

    def _send(self) -> None:
        data = self.line.inbox.take(1 << 16, self.now_s())
        if not data or self._master < 0:
            return
        try:
            os.write(self._master, data)
        except BlockingIOError:
            pass  # the client does not read; a real adapter's buffer overflows just so
        except OSError as error:
            if error.errno != errno.EIO:
                raise
