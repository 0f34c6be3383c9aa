"""Compare the duration of whole commands with the start of Python itself, in alternation.

Run ``python tools/bench/startup.py``; the table goes to docs/benchmarks.md.
"""

from __future__ import annotations

import shutil
import statistics
import subprocess
import sys
import time

RUNS = 9
POINT = ["0.25", "0.05", "0.15", "--arm", "so101"]
COMMANDS = {
    "python -c pass": [sys.executable, "-c", "pass"],
    "python -c 'import numpy'": [sys.executable, "-c", "import numpy"],
    "ikservo --help": ["ikservo", "--help"],
    "ikservo arms": ["ikservo", "arms"],
    "ikservo solve (reachable)": ["ikservo", "solve", *POINT],
    "ikservo solve (unreachable)": ["ikservo", "solve", "0.9", "0", "0.2", "--arm", "so101"],
    "ikservo move --port sim": ["ikservo", "move", *POINT, "--port", "sim"],
}


def main() -> None:
    """Time every command in turn, so that a slow moment of the machine affects all equally."""
    ikservo = shutil.which("ikservo", path=str(sys.prefix) + "/bin") or "ikservo"
    times_s: dict[str, list[float]] = {name: [] for name in COMMANDS}
    for turn in range(RUNS + 1):
        for name, words in COMMANDS.items():
            elapsed_s = _timed([ikservo if word == "ikservo" else word for word in words])
            if turn:  # the first round fills the caches
                times_s[name].append(elapsed_s)
    bare_s = statistics.median(times_s["python -c pass"])
    print("| command | median | fastest | slowest | of bare Python |")
    print("|---|---:|---:|---:|---:|")
    for name, samples in times_s.items():
        median_s = statistics.median(samples)
        print(
            f"| `{name}` | {median_s:.3f} s | {min(samples):.3f} s | {max(samples):.3f} s "
            f"| {median_s / bare_s:.1f} × |"
        )


def _timed(words: list[str]) -> float:
    started_s = time.perf_counter()
    subprocess.run(words, capture_output=True, check=False)
    return time.perf_counter() - started_s


if __name__ == "__main__":
    main()
