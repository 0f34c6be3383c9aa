"""Serving a simulated bus to other software: what ``ikservo sim`` runs."""

from __future__ import annotations

import contextlib
import gc
import json
import os
import signal
import sys
from collections.abc import Generator, Sequence
from dataclasses import replace

from servosim.adapter import AdapterOptions
from servosim.arm_file import read_arm_file
from servosim.assembly import loose_world, world_of_arm
from servosim.errors import SimulatorError
from servosim.faults import read_faults
from servosim.line import Line, LineOptions
from servosim.serving.options import Options, parse
from servosim.serving.pty import PtyBus
from servosim.serving.remote import Remote
from servosim.serving.screen import Screen
from servosim.sweep import SweepingHands
from servosim.traffic import Audit, Journal

__all__ = ["serve"]

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)  # the last: its terminal was closed
GAP_S = 0.020  # a client's scheduler tears frames apart where a wire would not


def serve(argv: Sequence[str]) -> int:
    """Serve an arm or loose servos until SIGINT, SIGTERM or SIGHUP; the first line is the port.

    Args:
        argv: Path of an ``arm.toml`` or ``--servo``, then options; ``--help`` lists them.

    Returns:
        0 after a signal, 2 when the options cannot be used.
    """
    options = parse(argv)
    with contextlib.ExitStack() as stack:
        try:
            bus, remote, screen = _open(options, stack)
        except (SimulatorError, OSError) as error:
            sys.stderr.write(f"{error}\n")
            return 2
        _work_until_signal(bus, remote, screen)
    return 0


def _open(options: Options, stack: contextlib.ExitStack) -> tuple[PtyBus, Remote, Screen]:
    """Build and open everything; the stack puts it away again, the port last."""
    line = build_line(options)
    bus = PtyBus(line, options.link)
    stack.callback(bus.unplug)
    _attach_witnesses(line, options, stack)
    remote = stack.enter_context(Remote(options.control, line))
    return bus, remote, stack.enter_context(Screen(bus))


def build_line(options: Options) -> Line:
    """Return the line that the options describe.

    Raises:
        SimulatorError: An arm file, a model, a rate or a fault that cannot be used.
    """
    line_options = LineOptions(
        wire_time=options.wire_time,
        gap_s=GAP_S,
        noise=options.noise,
        seed=options.seed,
        adapter=AdapterOptions(
            options.echo, options.usb_frame_ms / 1000, options.latency_ms / 1000
        ),
    )
    if options.arm is not None:
        arm = read_arm_file(options.arm)
        arm = replace(arm, baud=options.baud or arm.baud)
        world = world_of_arm(
            arm,
            options.pose or "rest",
            options.seed,
            physics=options.physics,
            backlash_deg=options.backlash_deg,
        )
        line = Line(world, arm.baud, line_options)
    else:
        world = loose_world(options.servos, options.baud, options.seed, protocol=options.protocol)
        line = Line(world, options.baud or world.servos[0].baud, line_options)
    for fault in read_faults(options.faults) if options.faults else []:
        line.faults.add(fault)
    if options.hand == "sweep":
        line.witnesses.append(SweepingHands(world))
    return line


def _attach_witnesses(line: Line, options: Options, stack: contextlib.ExitStack) -> None:
    if options.log is not None:
        journal = Journal(options.log, line.world.servos)
        stack.callback(journal.close)
        line.witnesses.append(journal)
    if options.audit is not None:
        audit = Audit(line.world.servos)
        file = stack.enter_context(options.audit.open("w", encoding="utf-8"))
        line.witnesses.append(audit)

        def report() -> None:
            json.dump(audit.report(list(line.readers.values())), file, indent=2)
            file.write("\n")

        stack.callback(report)


def _work_until_signal(bus: PtyBus, remote: Remote, screen: Screen) -> None:
    gc.freeze()
    with _signals_as_pipe() as signalled:
        screen.announce()
        while True:
            ready = bus.work((signalled, *remote.sockets()))
            if signalled in ready or remote.serve(ready):
                return
            screen.refresh()


@contextlib.contextmanager
def _signals_as_pipe() -> Generator[int, None, None]:
    """Give a file descriptor that can be read once a signal to end has arrived."""
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    before = signal.set_wakeup_fd(writer)
    handlers = {number: signal.signal(number, _nothing) for number in ENDING}
    try:
        yield reader
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(before)
        os.close(reader)
        os.close(writer)


def _nothing(_: int, __: object) -> None:
    """The wake-up pipe tells."""
