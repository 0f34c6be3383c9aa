"""What the server shows: a live table on a terminal, one line with the port elsewhere."""

from __future__ import annotations

import contextlib
import os
import sys
from typing import Any

from servosim.serving.pty import PtyBus
from servosim.serving.state import servo_state

__all__ = ["Screen"]

REFRESH_S = 0.25
HEAD = (
    f"{'id':>3}  {'model':<11} {'joint':<16}{'position':>9}{'goal':>7}{'load':>7}{'°C':>5}{'V':>6}"
)


class Screen:
    """Writes to stdout; a terminal is kept up to date while something changes."""

    def __init__(self, bus: PtyBus) -> None:
        self._bus = bus
        plain = "NO_COLOR" in os.environ or os.environ.get("TERM") == "dumb"
        self._live = sys.stdout.isatty() and not plain
        self._shown: list[str] = []
        self._next_s = 0.0

    def __enter__(self) -> Screen:
        return self

    def __exit__(self, *_: object) -> None:
        if self._live:
            self._put("\x1b[?25h")

    def announce(self) -> None:
        """Tell the port."""
        self._put(f"{self._bus.link or self._bus.path}\n" if self._live else f"{self._bus.path}\n")
        if self._live:
            self._put("\x1b[?25l")

    def refresh(self) -> None:
        """Bring the table up to date, if there is one and it is time."""
        now_s = self._bus.now_s()
        if not self._live or now_s < self._next_s:
            return
        self._next_s = now_s + REFRESH_S
        lines = self._table()
        if lines != self._shown:
            up = f"\x1b[{len(self._shown)}A" if self._shown else ""
            self._put(up + "".join(f"\x1b[2K{line}\n" for line in lines))
            self._shown = lines

    def _table(self) -> list[str]:
        world = self._bus.line.world
        rows = [servo_state(joint, servo) for joint in world.joints for servo in joint.servos]
        return [HEAD, *(_row(row) for row in rows)]

    def _put(self, text: str) -> None:
        with contextlib.suppress(OSError):  # the terminal may be gone: the servos go on
            sys.stdout.write(text)
            sys.stdout.flush()


def _row(state: dict[str, Any]) -> str:
    marks = ("torque " if state["torque"] else "") + ("ALARM" if state["alarm"] else "")
    return (
        f"{state['id']:>3}  {state['model']:<11} {state['joint']:<16}{state['position']:>9}"
        f"{state['goal']:>7}{state['load']:>6.0%} {state['temperature_c']:>5.1f}"
        f"{state['voltage_v']:>6.1f}  {marks}"
    )
