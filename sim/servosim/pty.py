"""The line behind a pseudo-terminal in real time, for any client software."""

from __future__ import annotations

import errno
import fcntl
import os
import select
import struct
import sys
import termios
import time
import tty
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from servosim.errors import SimulatorError
from servosim.frames import FrameReader
from servosim.line import Line


def point_link(link: Path, port: Path) -> None:
    """Make a symbolic link to a port; an older link is replaced, anything else is not.

    Raises:
        SimulatorError: Something else has that name.
    """
    if link.is_symlink():
        link.unlink()
    elif link.exists():
        raise SimulatorError(f"{link} already exists and is not a link; choose another name")
    link.symlink_to(port)


def remove_link(link: Path, port: Path) -> None:
    """Remove the link, unless another process has pointed it to another port."""
    if link.is_symlink() and link.readlink() == port:
        link.unlink()


_TCGETS2 = 0x802C542A  # Linux, asm-generic/ioctls.h
_TERMIOS2 = struct.Struct("4IB19s2I")  # four flag words, discipline, characters, both speeds
_NAMED = {
    getattr(termios, name): int(name[1:])
    for name in dir(termios)
    if name.startswith("B") and name[1:].isdigit()
}


def line_speed(fd: int) -> int | None:
    """Compute the output speed of the terminal's slave end [bit/s], or None if unknown."""
    try:
        if sys.platform == "linux":
            raw = fcntl.ioctl(fd, _TCGETS2, bytes(_TERMIOS2.size))
            return int(_TERMIOS2.unpack(raw)[-1]) or None
        speed = termios.tcgetattr(fd)[5]
    except (OSError, termios.error):
        return None
    return _NAMED.get(speed, speed) or None


SPIN_S = 100e-6  # the kernel wakes a process about this late, so the rest is a busy wait
ACTIVE_STEP_S = 0.002  # a world in motion is kept up to date in small steps
IDLE_STEP_S = 0.050
NO_CLIENT_STEP_S = 0.010  # time between two polls for a client
MAX_LATE_S = 0.030  # largest delay of the server that servos see


class PtyBus:
    """A pseudo-terminal whose master end is the line.

    Replies are written when their last byte is due: the simulator's own work is done during the
    transmission time of the bytes. Only the client holds the slave end open, so that exclusive
    opening and hanging up work as on a real port.

    A server that was not scheduled catches up by at most `MAX_LATE_S` before it replies. Longer
    delays are left out of the line's time: it is unknown when waiting bytes were written, and
    servos that had moved on meanwhile would miss the goals among them, and reply late.

    Attributes:
        path: The slave's device file.
        link: A symbolic link to it, or None.
        follow_baud: Whether the line uses the rate that the client has set.
    """

    def __init__(self, line: Line, link: Path | None = None) -> None:
        self.line, self.link = line, link
        self.follow_baud = True
        self._start_s = time.monotonic()
        self._readers: dict[type[FrameReader], FrameReader] = {}
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
        """Close the terminal: the client gets the error of an unplugged USB cable."""
        if self._master >= 0:
            os.close(self._master)
            self._master = -1
        if self.link is not None:
            remove_link(self.link, self.path)

    def now_s(self) -> float:
        """Compute the line's time: real seconds since the start, without long delays."""
        return time.monotonic() - self._start_s

    def process_events(self, also: Sequence[int] = ()) -> list[int]:
        """Process due events and wait for more; return those of ``also`` that can be read."""
        self._update_cable()
        due_s = self._next_due_s()
        ready = self._wait_for_events(due_s, also)
        late_s = self.now_s() - self.line.world.time_s - self._step_s()
        self._start_s += max(0.0, late_s - MAX_LATE_S)
        if self._master in ready:
            self._receive_bytes()
        else:
            self.line.run_until(self.now_s())
        self._send_replies()
        return [fd for fd in ready if fd != self._master]

    def _next_due_s(self) -> float:
        due = [
            self.now_s() + self._step_s(),
            self.line.next_event_s,
            self.line.inbox.next_end_s(),
        ]
        return min(at_s for at_s in due if at_s is not None)

    def _step_s(self) -> float:
        return IDLE_STEP_S if self.line.world.is_idle else ACTIVE_STEP_S

    def _update_cable(self) -> None:
        """Apply a fault that pulls the cable and plugs it in again."""
        if self.line.plugged and self._master < 0:
            self.plug()
        elif not self.line.plugged and self._master >= 0:
            self.unplug()

    def _wait_for_events(self, due_s: float, also: Sequence[int]) -> list[int]:
        watched = [fd for fd in (self._master, *also) if fd >= 0]
        sleep_s = max(0.0, due_s - self.now_s() - SPIN_S)
        ready = select.select(watched, [], [], sleep_s)[0]
        while not ready and self.now_s() < due_s:
            pass
        return ready

    def _receive_bytes(self) -> None:
        data = self._read_terminal()
        if not data:
            return
        now_s = self.now_s()
        if self.follow_baud:
            self.line.set_baud(line_speed(self._master) or self.line.baud)
        for part in self._split_after_instructions(data):
            self.line.host_write(part, max(now_s, self.line.replies_end_s))
            self.line.run_until(self.line.all_received_s)

    def _split_after_instructions(self, data: bytes) -> list[bytes]:
        """Cut the received bytes after each instruction, so that each waits for the previous reply.

        The times of waiting bytes are unknown. A server that was not scheduled in time finds an
        instruction and its repetition in one read; as one burst they would collide with the reply,
        which never happens on real servos, because they reply at once.
        """
        for framing in {servo.framing for servo in self.line.world.servos} - set(self._readers):
            self._readers[framing] = framing()
        ends = {frame.end for reader in self._readers.values() for frame in reader.feed(data)}
        cuts = [0, *sorted(ends - {len(data)}), len(data)]
        return [data[start:end] for start, end in pairwise(cuts)]

    def _read_terminal(self) -> bytes:
        try:
            return os.read(self._master, 4096)
        except BlockingIOError:
            return b""
        except OSError as error:
            if error.errno != errno.EIO:
                raise
            self._handle_no_client()
            return b""

    def _handle_no_client(self) -> None:
        """Discard replies while no client has the terminal open, and poll again a little later."""
        time.sleep(NO_CLIENT_STEP_S)
        now_s, world = self.now_s(), self.line.world
        if not world.is_idle or now_s - world.time_s > IDLE_STEP_S:
            self.line.run_until(now_s)
        self.line.inbox.clear(now_s)

    def _send_replies(self) -> None:
        data = self.line.inbox.take(1 << 16, self.now_s())
        if not data or self._master < 0:
            return
        try:
            os.write(self._master, data)
        except BlockingIOError:
            pass  # the client does not read; a real adapter's buffer also overflows
        except OSError as error:
            if error.errno != errno.EIO:
                raise
