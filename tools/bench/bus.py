"""Time reading six positions and writing six goals: ikservo, the vendors' SDKs and rustypot.

Run ``python tools/bench/bus.py``; the table goes to docs/benchmarks.md. Each line is served by
``ikservo sim`` behind a pseudo-terminal in real time, with wire time; peers alternate on it, so
that a slow moment of the machine affects all equally; ratios and fractions are of medians, which
a busy machine disturbs least. rustypot gets a virtual environment of its own.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from environments import Peer, UnavailableError, interpreter_for

ROOT = Path(__file__).parents[2]
RUNNER = Path(__file__).with_name("line_peers.py")
SERVE = "import sys, servosim; sys.exit(servosim.serve(sys.argv[1:]))"
RUSTYPOT = Peer("rustypot", RUNNER.name, ("rustypot",))
COUNT, BITS_PER_BYTE = 6, 10


@dataclass(frozen=True)
class Bench:
    """A line and the peers measured on it.

    Attributes:
        title: Its title in the table.
        model: Model of all six servos.
        family: Their protocol family, as in arm.toml.
        baud: Baud rate of the line.
        wire_bytes: Number of bytes of the protocol's shortest request, replies and goals.
        peers: Names in ``line_peers.py``.
    """

    title: str
    model: str
    family: str
    baud: int
    wire_bytes: int
    peers: tuple[str, ...]

    @property
    def limit_hz(self) -> float:
        """The cycles per second that the wire allows; return delays are 0."""
        return self.baud / (self.wire_bytes * BITS_PER_BYTE)


@dataclass
class Result:
    """The measurements of one peer."""

    took_s: list[float] = field(default_factory=list[float])
    busy_s: list[float] = field(default_factory=list[float])
    failed: int = 0

    @property
    def rate_hz(self) -> float:
        """The cycles per second over all rounds."""
        return len(self.took_s) / sum(self.took_s)

    def took(self, quantile: float) -> float:
        """Return a quantile of the cycle's duration, seconds."""
        ordered = sorted(self.took_s)
        return ordered[min(int(quantile * len(ordered)), len(ordered) - 1)]


STS_BYTES = (8 + COUNT + COUNT * 8) + (8 + COUNT * 3)
FAST_BYTES = (14 + COUNT + 8 + COUNT * 8) + (14 + COUNT * 5)
DYNAMIXEL = ("ikservo", "ikservo_recorded", "dynamixel_sdk", "dynamixel_sdk_fast", "rustypot")
# fmt: off
BENCHES = (
    Bench("six STS3215, 1 Mbaud", "STS3215",    "feetech_sts", 1_000_000, STS_BYTES,
          ("ikservo", "ikservo_recorded", "scservo_sdk", "rustypot")),
    Bench("six XL330, 1 Mbaud",   "XL330-M288", "dynamixel_2", 1_000_000, FAST_BYTES, DYNAMIXEL),
    Bench("six XL330, 4 Mbaud",   "XL330-M288", "dynamixel_2", 4_000_000, FAST_BYTES, DYNAMIXEL),
)
# fmt: on


def main() -> None:
    """Measure all benches and print one table."""
    options = _parser().parse_args()
    print("| line | peer | ikservo is × faster | of the wire limit | p50 | p99 | p99.9 | cycles/s "
          "| processor time | failed |")  # fmt: skip
    print("|---|---|---:|---:|---:|---:|---:|---:|---:|---:|")
    for bench in BENCHES:
        _print(bench, _measured(bench, options.rounds, options.cycles))


def _measured(bench: Bench, rounds: int, cycles: int) -> dict[str, Result]:
    results = {peer: Result() for peer in bench.peers}
    with _served(bench) as port:
        _run("ikservo", bench, port, cycles, Result())  # lets the simulator settle, too
        for _ in range(rounds):
            for peer, result in results.items():
                _run(peer, bench, port, cycles, result)
    return {peer: result for peer, result in results.items() if result.took_s}


def _run(peer: str, bench: Bench, port: str, cycles: int, result: Result) -> None:
    try:
        python = interpreter_for(RUSTYPOT) if peer == "rustypot" else Path(sys.executable)
    except UnavailableError as error:
        print(f"{peer} is left out: {error}", file=sys.stderr)
        return
    words = [str(python), str(RUNNER), peer, port, str(bench.baud), bench.family, str(cycles)]
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=120)
    if done.returncode:
        print(f"{peer} failed: {done.stderr.strip().splitlines()[-1]}", file=sys.stderr)
        return
    said = json.loads(done.stdout)
    result.took_s += said["took_s"]
    result.busy_s.append(said["busy_s"])
    result.failed += said["failed"]


@contextmanager
def _served(bench: Bench) -> Generator[str]:
    """Serve six servos of one model on the SO-101's joints; yield the port."""
    shelf = ROOT / "configs" / "so101"
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "arm.urdf").write_text((shelf / "arm.urdf").read_text())
        (folder / "arm.toml").write_text(_arm_file(bench, (shelf / "arm.toml").read_text()))
        words = [sys.executable, "-c", SERVE, str(folder / "arm.toml")]
        with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as server:
            assert server.stdout is not None
            try:
                yield server.stdout.readline().strip()
            finally:
                server.terminate()


def _arm_file(bench: Bench, text: str) -> str:
    is_feetech = bench.family == "feetech_sts"
    delay, supply_v = ("return_delay", 7.4) if is_feetech else ("return_delay_time", 5.0)
    return (
        text.replace("STS3215", bench.model)
        .replace('"feetech_sts"', f'"{bench.family}"')
        .replace("baud   = 1_000_000", f"baud   = {bench.baud}")
        .replace("supply_v = 7.4", f"supply_v = {supply_v}")
        .replace("zero_tick = 2048 }", f"zero_tick = 2048, eeprom = {{ {delay} = 0 }} }}")
    )


def _print(bench: Bench, results: dict[str, Result]) -> None:
    ours_s = results["ikservo"].took(0.5)
    for peer, result in results.items():
        share = 100 / (result.took(0.5) * bench.limit_hz)
        times = " | ".join(f"{1000 * result.took(q):.2f} ms" for q in (0.5, 0.99, 0.999))
        busy_us = 1e6 * statistics.median(result.busy_s)
        print(
            f"| {bench.title} | {peer} | {result.took(0.5) / ours_s:.2f} | {share:.0f} % "
            f"| {times} | {result.rate_hz:.0f} | {busy_us:.0f} µs | {result.failed} |",
            flush=True,
        )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5, help="turns of each peer")
    parser.add_argument("--cycles", type=int, default=600, help="cycles in a turn")
    return parser


if __name__ == "__main__":
    main()
