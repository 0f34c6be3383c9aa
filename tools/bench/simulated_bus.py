"""Measure the simulated bus: cycles per second, overhead of a pseudo-terminal, idle load.

Run ``python tools/bench/simulated_bus.py``; results belong in docs/benchmarks.md.
"""

from __future__ import annotations

import math
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import serial

import servosim
from servosim.frames import encode1, encode2
from servosim.port import SimulatedPort

CONFIGS = Path(__file__).parents[2] / "configs"
SERVE = "import sys, servosim; sys.exit(servosim.serve(sys.argv[1:]))"
CYCLES = 5_000
ASKS = 1_000
SETTLE_S = 3.0
IDLE_S = 10.0
BYTE_S = 10 / 1_000_000
Goals = Callable[[int], bytes]


def main() -> None:
    """Measure and print."""
    for arm in ("so101", "koch"):
        cycles = cycles_per_second(arm)
        print(f"{arm}: {cycles:,.0f} cycles/s of sync read + sync write, six servos, with physics")
    for arm in ("so101", "koch"):
        print(f"{arm} served and left alone: {idle_share(arm):.1%} of a core")
        median_s, p99_s = pty_overhead_s(arm)
        print(
            f"{arm} on a pty: median {median_s * 1e3:.3f} ms over wire time, p99 {p99_s * 1e3:.3f}"
        )


def idle_share(arm: str) -> float:
    """Leave a served arm idle; return the fraction of a core that it uses."""
    command = [sys.executable, "-c", SERVE, str(CONFIGS / arm / "arm.toml")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        time.sleep(SETTLE_S)  # the arm, torque off, comes to rest
        before_s = _used_s(server.pid)
        time.sleep(IDLE_S)
        used_s = _used_s(server.pid) - before_s
        server.terminate()
    return used_s / IDLE_S


def _used_s(pid: int) -> float:
    """Return processor seconds of a process (Linux)."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def cycles_per_second(arm: str) -> float:
    """Drive six servos along a slow sine; return cycles per second of processor time."""
    port = servosim.open_port(f"sim:{CONFIGS / arm / 'arm.toml'}?pose=home")
    port.timeout = 0.02
    for servo in port.line.servos.values():
        if "return_delay_time" in servo.table.by_name:
            servo.write("return_delay_time", 0)
        servo.write("torque_enable", 1)
    read, size, goals = _feetech(port) if arm.startswith("so") else _dynamixel(port)
    start_s = time.process_time()
    for k in range(CYCLES):
        port.write(read)
        if len(port.read(size)) != size:
            raise RuntimeError(f"{arm}: cycle {k} is not answered")
        port.write(goals(k))
        port.flush()
    return CYCLES / (time.process_time() - start_s)


def pty_overhead_s(arm: str) -> tuple[float, float]:
    """Read six servos through a pseudo-terminal; return median and p99 of the excess time."""
    feetech = arm.startswith("so")
    command = [sys.executable, "-c", SERVE, str(CONFIGS / arm / "arm.toml")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        path = server.stdout.readline().strip() if server.stdout else ""
        ids = bytes(range(1, 7))
        ask = encode1(254, 0x82, b"\x38\x02" + ids) if feetech else _sync_read(ids)
        size = 6 * (8 if feetech else 15)
        delays_s = 0.0 if feetech else 6 * 500e-6
        wire_s = (len(ask) + size) * BYTE_S + delays_s
        with serial.Serial(path, 1_000_000, timeout=0.5) as port:
            times_s = sorted(_timed(port, ask, size) - wire_s for _ in range(ASKS))
        server.terminate()
    return statistics.median(times_s), times_s[int(0.99 * ASKS)]


def _timed(port: serial.Serial, ask: bytes, size: int) -> float:
    start_s = time.perf_counter()
    port.write(ask)
    if len(port.read(size)) != size:
        raise RuntimeError("not answered")
    return time.perf_counter() - start_s


def _feetech(port: SimulatedPort) -> tuple[bytes, int, Goals]:
    home = {id_: servo.read("present_position") for id_, servo in port.line.servos.items()}

    def goals(k: int) -> bytes:
        words = [bytes((i,)) + _sine(at, k).to_bytes(2, "little") for i, at in home.items()]
        return encode1(254, 0x83, b"\x2a\x02" + b"".join(words))

    return encode1(254, 0x82, b"\x38\x02" + bytes(home)), 8 * len(home), goals


def _dynamixel(port: SimulatedPort) -> tuple[bytes, int, Goals]:
    home = {id_: servo.read("present_position") for id_, servo in port.line.servos.items()}

    def goals(k: int) -> bytes:
        words = [bytes((i,)) + _sine(at, k).to_bytes(4, "little") for i, at in home.items()]
        return encode2(254, 0x83, b"\x74\x00\x04\x00" + b"".join(words))

    return _sync_read(bytes(home)), 15 * len(home), goals


def _sync_read(ids: bytes) -> bytes:
    return encode2(254, 0x82, b"\x84\x00\x04\x00" + ids)


def _sine(centre: int, k: int) -> int:
    return int(centre + 40 * math.sin(0.005 * k))


if __name__ == "__main__":
    main()
