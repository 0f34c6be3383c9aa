"""Measure the effect of many page clients on the arm: cycle times with and without them.

Run ``python tools/bench/crowd.py``; results belong in docs/benchmarks.md. The bus is simulated, in
this process, at real speed; the clients are a process of their own. Each crowd is measured between
two rounds without one, so that other load of the machine affects both.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Generator
from contextlib import contextmanager
from itertools import pairwise
from statistics import median

from visiting import Page, served

from ikservo.apps.page.served_arms import ServedArm
from ikservo.control.loop import ControlCycle

SECONDS, ROUNDS = 4.0, 5

_OPEN = """
import socket, sys, time
host, port = sys.argv[1], int(sys.argv[2])
def one():
    try: return socket.create_connection((host, port))
    except OSError: return None
def say(s, words):
    try: s.send(words)
    except (OSError, AttributeError): return False
    return True
crowd = [one() for _ in range(200)]
print("there", flush=True)
"""
_CLIENT_COUNTS = {
    "200 idle sockets": "time.sleep(1000)",
    "200 sockets, a byte a second each": """
while True:
    for i, s in enumerate(crowd):
        if not say(s, b"G"): crowd[i] = one()
        time.sleep(1 / 200)
""",
    "100 new sockets a second": """
while True:
    crowd.append(one()); crowd.pop(0); time.sleep(1 / 100)
""",
    "100 requests a second": """
ask = f"GET / HTTP/1.1\\r\\nHost: {host}:{port}\\r\\n\\r\\n".encode()
crowd = crowd[-1:]
crowd[0].setblocking(False)
while True:
    if not say(crowd[0], ask): crowd[0] = one()
    try: crowd[0].recv(1 << 20)
    except (OSError, AttributeError): pass
    time.sleep(1 / 100)
""",
}


@contextmanager
def crowded(clients: str, url: str) -> Generator[None]:
    """Keep a crowd of clients connected as long as the block lasts."""
    host, port = url.removeprefix("http://").split(":")
    command = [sys.executable, "-c", _OPEN + _CLIENT_COUNTS[clients], host, port]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        if process.stdout is not None:
            process.stdout.readline()
        try:
            yield
        finally:
            process.kill()


def cycles_ms(house: ServedArm, page: Page) -> list[float]:
    """Return the cycle times while the arm is dragged by a page that draws."""
    at_s: list[float] = []
    on_cycle = house.arm_thread.on_cycle

    def record(cycle: ControlCycle) -> None:
        on_cycle(cycle)
        at_s.append(time.perf_counter())

    house.arm_thread.on_cycle = record
    end_s = time.monotonic() + SECONDS
    page.point("down", 560, 250)
    while (left_s := end_s - time.monotonic()) > 0:
        page.point("move", 560 + 60 * (left_s % 1.0), 250 + 40 * (left_s % 0.7))
        page.live_for(1 / 60)
    page.point("up", 560, 250)
    house.arm_thread.on_cycle = on_cycle
    return [1000 * (b - a) for a, b in pairwise(at_s)]


def p99(times: list[float]) -> float:
    """Return the value that one in a hundred exceeds."""
    return sorted(times)[int(0.99 * len(times))]


def main() -> None:
    """Run the measurements and print the results."""
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    with served("so101", "home") as (house, page):
        for clients in _CLIENT_COUNTS:
            alone: list[float] = []
            among: list[float] = []
            for _ in range(ROUNDS):
                alone += cycles_ms(house, page)
                with crowded(clients, page.url):
                    among += cycles_ms(house, page)
            print(f"{clients}: cycle p50 {median(alone):.2f} -> {median(among):.2f} ms, "
                  f"p99 {p99(alone):.2f} -> {p99(among):.2f} ms "
                  f"({100 * (p99(among) / p99(alone) - 1):+.0f} %)")  # fmt: skip
    print(f"load {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
