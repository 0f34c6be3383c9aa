"""The options of the server: an arm or loose servos, and what goes wrong with them."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from servosim.assembly import LooseServo
from servosim.tables import TABLES

__all__ = ["Options", "parse"]

EPILOG = """examples:
  ikservo sim so101 --link /tmp/arm
  ikservo sim --servo 1-3:xl430-w250 --servo 4-6:xl330-m288 --baud 1000000
  ikservo sim koch --faults faults.toml --log frames.txt --audit audit.json
"""


class Options(argparse.Namespace):
    """What the command line says."""

    arm: Path | None
    groups: list[list[LooseServo]] | None
    servos: list[LooseServo]
    protocol: int | None
    baud: int | None
    pose: str | None
    seed: int
    link: Path | None
    faults: Path | None
    wire_time: bool
    physics: bool
    backlash_deg: float | None
    hand: str | None
    log: Path | None
    audit: Path | None
    control: Path | None
    echo: bool
    noise: float
    usb_frame_ms: float
    latency_ms: float


def parse(argv: Sequence[str]) -> Options:
    """Return the options; exits with a message when they make no sense."""
    parser = _parser()
    options = parser.parse_args(argv, Options())
    options.servos = [servo for group in options.groups or [] for servo in group]
    if bool(options.servos) == (options.arm is not None):
        parser.error(
            "give an arm or --servo, not both" if options.servos else "give an arm or --servo"
        )
    mine = ("protocol",) if options.arm is not None else ("pose", "physics", "backlash_deg")
    for name in mine:
        if getattr(options, name):
            other = "--servo" if options.arm is not None else "an arm"
            parser.error(f"--{name.replace('_', '-')} is an option of {other}")
    return options


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="ikservo sim",
        description="Serve simulated servos behind a pseudo-terminal until Ctrl-C. "
        "The first line on stdout is the port.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("arm", nargs="?", type=Path, help="an arm")
    add(
        "--servo",
        dest="groups",
        type=_servos,
        action="append",
        metavar="IDS:MODEL",
        help="servos without an arm, as 4:sts3215, 1-3:xl430-w250 or 1:sts3215@115200; "
        "may be repeated",
    )
    add("--protocol", type=int, choices=(1, 2), help="protocol of --servo Dynamixel X servos")
    add("--baud", type=_rate, help="rate the servos are set to (--servo: as from the factory)")
    add("--pose", help="pose of the arm to start at (rest)")
    add("--seed", type=int, default=0, help="of all chance (0)")
    add("--link", type=Path, help="symbolic link to the port, removed at exit")
    add("--faults", type=Path, metavar="FILE", help="what goes wrong, TOML or JSON")
    add("--no-wire-time", dest="wire_time", action="store_false", help="bytes take no time")
    add("--physics", action="store_true", help="bodies and contacts from MuJoCo")
    add("--backlash-deg", type=float, metavar="DEG", help="free play of the arm's gears")
    add(
        "--hand",
        choices=("sweep",),
        help="calibrate by hand: hold the pose, then sweep",
    )
    add("--log", type=Path, metavar="FILE", help="write each frame down")
    add("--audit", type=Path, metavar="FILE", help="write a report at exit, JSON")
    add("--control", type=Path, metavar="PATH", help="unix socket for commands, JSON lines")
    add("--echo", action="store_true", help="the host hears its own bytes")
    add("--noise", type=float, default=0.0, help="chance of each byte to have a bit flipped (0)")
    add("--usb-frame-ms", type=float, default=0.0, metavar="MS", help="USB frame time (0)")
    add("--latency-ms", type=float, default=0.0, metavar="MS", help="FTDI latency timer (0)")
    return parser  # fmt: skip


def _servos(text: str) -> list[LooseServo]:
    """Read ``1-3:xl430-w250``, ``1,4:sts3215`` or, at a rate of its own, ``7:ax-12a@57600``."""
    ids, _, wanted = text.partition(":")
    wanted, at, rate = wanted.partition("@")
    models = {name.lower(): name for name in TABLES}
    if wanted.lower() not in models:
        known = ", ".join(models)
        raise argparse.ArgumentTypeError(f"no model {wanted!r} in {text!r}; known: {known}")
    try:
        numbers = [number for part in ids.split(",") for number in _range(part)]
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{ids!r} are no ids; try 1-3:{wanted}") from error
    if not numbers:
        raise argparse.ArgumentTypeError(f"no id in {ids!r}; try 1-3:{wanted}")
    if not all(0 <= number <= 252 for number in numbers):
        raise argparse.ArgumentTypeError(f"ids go from 0 to 252, not {ids}")
    baud = _rate(rate) if at else None
    return [LooseServo(number, models[wanted.lower()], baud) for number in numbers]


def _rate(text: str) -> int:
    if not text.isascii() or not text.isdigit() or int(text) == 0:
        raise argparse.ArgumentTypeError(f"{text!r} is no rate; try 1000000")
    return int(text)


def _range(part: str) -> range:
    first, _, last = part.partition("-")
    return range(int(first), int(last or first) + 1)
