"""Compare our inverse kinematics with its peers: the same targets, the same clock, in one run.

Run ``python tools/bench/ik.py``; the tables go to docs/benchmarks.md. Each peer gets a virtual
environment of its own under build/bench-venvs, made by pip when it is first needed.
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import platform
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from environments import PEERS, Peer, UnavailableError, interpreter_for
from judging import Flags, Score, solved, worth
from problems import KINDS, Array, problem_of, rounds_of
from tables import Row, missing_table, speed_table

import ikservo

RUNNERS = Path(__file__).parent / "peers"
_TIMEOUT_S = 900


@dataclass
class Talk:
    """One peer's results for one arm and kind, or the reason why there are none."""

    peer: Peer
    answer: dict[str, Any] = field(default_factory=dict[str, Any])
    refusal: str = ""


def main() -> None:
    """Run all peers and print the results."""
    options = _options()
    rows: list[Row] = []
    refusals: list[tuple[str, str, str, str]] = []
    for arm in options.arms:
        model = ikservo.load_model(arm)
        for kind in options.kinds:
            rounds = rounds_of(model, kind, options.targets, options.lines, options.seed)
            talks = [_ask(peer, model, kind, rounds, options) for peer in _chosen(options.peers)]
            rows += _rows(model, kind, rounds, [talk for talk in talks if not talk.refusal])
            refusals += [(t.peer.name, arm, kind, t.refusal) for t in talks if t.refusal]
    print(_heading(options))
    print(speed_table(rows))
    print(missing_table(refusals))


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=_Raw)
    names = [peer.name for peer in PEERS]
    parser.add_argument("--arms", nargs="+", default=ikservo.arm_names(), metavar="ARM")
    parser.add_argument("--kinds", nargs="+", default=KINDS, choices=KINDS)
    parser.add_argument("--peers", nargs="+", default=names, choices=names, metavar="PEER")
    parser.add_argument("--targets", type=int, default=1000, help="from home and from within 5°")
    parser.add_argument("--lines", type=int, default=3, help="lines of 1,000 points each")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--budget", type=float, default=30.0, help="most seconds per round")
    return parser.parse_args()


class _Raw(argparse.ArgumentDefaultsHelpFormatter, argparse.RawDescriptionHelpFormatter):
    pass


def _chosen(names: list[str]) -> list[Peer]:
    return [peer for peer in PEERS if peer.name in names]


def _ask(
    peer: Peer,
    model: ikservo.Model,
    kind: str,
    rounds: dict[str, dict[str, Any]],
    options: argparse.Namespace,
) -> Talk:
    """Start the peer's runner, send it the problem and wait for its results."""
    print(f"{model.name}, {kind}: {peer.name} …", file=sys.stderr, flush=True)
    request = {"problem": problem_of(model, kind), "rounds": rounds, "budget_s": options.budget}
    try:
        command = [str(interpreter_for(peer)), str(RUNNERS / peer.runner)]
        done = subprocess.run(
            command,
            input=json.dumps(request),
            capture_output=True,
            text=True,
            check=True,
            timeout=_TIMEOUT_S,
            env=os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
        )
    except UnavailableError as reason:
        return Talk(peer, refusal=str(reason))
    except subprocess.TimeoutExpired:
        return Talk(peer, refusal=f"no answer within {_TIMEOUT_S} s")
    except subprocess.CalledProcessError as failure:
        words = str(failure.stderr).strip().splitlines() or [f"exit code {failure.returncode}"]
        return Talk(peer, refusal=words[-1][:160])
    answer = json.loads(done.stdout)
    return Talk(peer, answer, refusal=answer.get("cannot", ""))


def _rows(
    model: ikservo.Model, kind: str, rounds: dict[str, dict[str, Any]], talks: list[Talk]
) -> list[Row]:
    """Score all results; a point of a line counts if at least one solver reached it."""
    scores: dict[str, dict[str, Score]] = {talk.peer.name: {} for talk in talks}
    for name, targets in rounds.items():
        reached: dict[str, Array] = {
            talk.peer.name: solved(model.chain, kind, targets, talk.answer["rounds"][name]["q"])
            for talk in talks
        }
        possible: Flags = np.any([hits == 1.0 for hits in reached.values()], axis=0)
        possible |= name != "line"  # only points between those of lines may be out of reach
        for talk in talks:
            own = reached[talk.peer.name]
            answer = talk.answer["rounds"][name]
            scores[talk.peer.name][name] = worth(targets, answer, own, possible)
    return [
        Row(
            model.name,
            model.chain.dof,
            kind,
            talk.peer.name,
            talk.answer["version"],
            scores[talk.peer.name],
            talk.answer["batch"] and talk.answer["batch"]["rate_hz"],
        )
        for talk in talks
    ]


def _heading(options: argparse.Namespace) -> str:
    today = datetime.datetime.now(datetime.UTC).date()
    return (
        f"{today}, {_processor()}, {os.cpu_count()} cores, {platform.system()}, "
        f"Python {platform.python_version()}; {options.targets} targets from home and from within "
        f"5°, {options.lines} lines of 1,000 points, seed {options.seed}.\n"
    )


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


if __name__ == "__main__":
    main()
