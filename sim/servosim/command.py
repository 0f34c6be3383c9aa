"""Serving a simulated bus to other software: what ``ikservo sim`` runs."""

from __future__ import annotations

import argparse
import gc
import os
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

from servosim.arm_file import read_arm_file
from servosim.assembly import world_of_arm
from servosim.line import Line, LineOptions
from servosim.pty import PtyBus

__all__ = ["serve"]

GAP_S = 0.020  # a client's scheduler tears frames apart where a wire would not


def serve(argv: Sequence[str]) -> int:
    """Serve an arm until SIGINT or SIGTERM; the first line on stdout is the port.

    Args:
        argv: Path of an ``arm.toml``, then options; ``--help`` lists them.

    Returns:
        0 after a signal.
    """
    options = _parser().parse_args(argv)
    arm = read_arm_file(Path(options.arm))
    world = world_of_arm(arm, options.pose, options.seed)
    line = Line(world, arm.baud, LineOptions(gap_s=GAP_S, seed=options.seed))
    bus = PtyBus(line, options.link)
    try:
        _run_until_signal(bus)
    finally:
        bus.unplug()
    return 0


def _run_until_signal(bus: PtyBus) -> None:
    """Tell the port and work until SIGINT or SIGTERM arrives through a pipe."""
    gc.freeze()
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    before = signal.set_wakeup_fd(writer)
    handlers = {number: signal.signal(number, _nothing) for number in _SIGNALS}
    try:
        sys.stdout.write(f"{bus.path}\n")
        sys.stdout.flush()
        while reader not in bus.work((reader,)):
            pass
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(before)
        os.close(reader)
        os.close(writer)


_SIGNALS = (signal.SIGINT, signal.SIGTERM)


def _nothing(_: int, __: object) -> None:
    """The wake-up pipe tells."""


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="ikservo sim", description=__doc__)
    parser.add_argument("arm", help="path of an arm.toml")
    parser.add_argument("--link", type=Path, help="symbolic link to the port, removed at exit")
    parser.add_argument("--pose", default="rest", help="pose of the arm file to start at")
    parser.add_argument("--seed", type=int, default=0, help="of all chance")
    return parser
