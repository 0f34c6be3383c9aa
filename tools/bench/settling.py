"""Measure how long points take to settle, and how far the tip still moves afterwards.

Run ``python tools/bench/settling.py``. Simulated arms of a family, with hidden play at every joint
and little friction inside it, move to random points in virtual time. Each row has the time from the
end of the trajectory to the result, the number of motions that ended in an error, the largest
distance of the true tip from where it was at the result during the two seconds after it, the
movement from two to three seconds after it, and the true tip's error after these seconds.

There are three plants. ``rigid`` is the simulator's own; ``mujoco`` has the bodies, gears and
friction of MuJoCo (``physics=1``); ``elastic`` is MuJoCo with flanks that yield and rebound.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from path_accuracy import LOWEST_M, SAMPLE_S, move_away, supplied

import ikservo
from ikservo.arm import Arm, MotionProgress
from ikservo.arm.opening import open_own_arm
from ikservo.errors import IkservoError, NotSettledError
from servosim import mujoco_body

Array = NDArray[np.float64]

ARMS = ("so101", "so101:12", "koch")  # with the supply in volts, if it is not the file's
PLANTS = ("rigid", "mujoco", "elastic")
PLAY_DEG, FRICTION_NM, VISCOUS_NM_S = (0.5, 2.0), (0.0, 0.01), (0.0, 0.01)
ELASTIC_FLANK = (0.006, 0.3)  # MuJoCo's solref: time constant and damping ratio
WATCHED_S, LATER_S = 2.0, 3.0


@dataclass
class Point:
    """One motion to a point.

    Attributes:
        settling_s: Time from the end of the trajectory to the result.
        moved_m: Largest distance of the tip from its position at the result, in two seconds.
        later_m: The same from two to three seconds after the result.
        error_m: The true tip's distance from the target at the end.
        failure: The error in which the motion ended; empty if there was none.
        notes: The notes of the report.
        mover: The joint that moved the tip most in these seconds.
    """

    settling_s: float = math.nan
    moved_m: float = math.nan
    later_m: float = math.nan
    error_m: float = math.nan
    failure: str = ""
    notes: Sequence[str] = field(default_factory=tuple[str, ...])
    mover: str = ""


def _hidden(seed: int, names: Sequence[str], folder: Path) -> Path:
    """Write the play and the friction inside it that one arm has; return the file."""
    rng, path = np.random.default_rng(seed), folder / f"hidden{seed}.toml"
    tables = [
        f'[[joints]]\nname = "{name}"\nbacklash_rad = {math.radians(rng.uniform(*PLAY_DEG))}\n'
        f"output_friction_nm = {rng.uniform(*FRICTION_NM)}\n"
        f"output_viscous_nm_s = {rng.uniform(*VISCOUS_NM_S)}\n"
        for name in names
    ]
    path.write_text("\n".join(tables))
    return path


def _points(name: str, plant: str, seed: int, options: argparse.Namespace) -> Iterator[Point]:
    mujoco_body.PLAY_SOLREF = ELASTIC_FLANK if plant == "elastic" else (0.002, 1.0)
    with tempfile.TemporaryDirectory() as folder:
        own, _, volts = name.partition(":")
        known = ikservo.load_model(own).path
        if volts:
            known = supplied(known, Path(folder) / "known", float(volts))
        model = ikservo.load_model(str(known))
        hidden = _hidden(seed, [joint.name for joint in model.joints], Path(folder))
        port = f"sim:{known}?seed={seed}&parameters={hidden}&physics={int(plant != 'rigid')}"
        with open_own_arm(model, port, uncalibrated=True) as arm:
            rng = np.random.default_rng(seed)
            move_away(arm, rng)
            for _ in range(options.count):
                yield _move(arm, rng, options.speed)


def _move(arm: Arm, rng: np.random.Generator, speed: str) -> Point:
    """Move to a random point that can be reached, and watch the tip afterwards."""
    chain, clock = arm.chain, arm.context.port.clock
    while True:
        target_m = chain.forward(rng.uniform(chain.lower_rad, chain.upper_rad))[:3, 3]
        with contextlib.suppress(IkservoError):
            if target_m[2] > LOWEST_M:
                plan = arm.plan_to(target_m, speed=speed)
                break
    point, ended_s = Point(), math.nan

    def watch(progress: MotionProgress) -> None:
        nonlocal ended_s
        if progress.elapsed_s >= plan.duration_s and math.isnan(ended_s):
            ended_s = clock.now_s()

    try:
        report: Any = arm.execute(plan, watch)
        point.notes = report.binding
    except IkservoError as error:
        point.failure = error.message
        if not isinstance(error, NotSettledError):
            arm.acknowledge()
    point.settling_s = clock.now_s() - ended_s
    port: Any = arm.context.port
    world = port.transport.line.world

    def joints() -> Array:
        return np.array([world.joint(name).position for name in chain.names])

    seen = [joints()]
    for _ in range(round(LATER_S / SAMPLE_S)):
        clock.sleep_until(clock.now_s() + SAMPLE_S)
        arm.where()  # the simulated line follows its host
        seen.append(joints())
    tips, later = chain.forward(np.array(seen))[:, :3, 3], round(WATCHED_S / SAMPLE_S)
    ways = np.abs(np.array(seen) - seen[0]).max(axis=0)
    ways *= np.linalg.norm(chain.jacobian(seen[0])[:3], axis=0)
    point.mover = chain.names[int(ways.argmax())]
    point.moved_m = float(np.linalg.norm(tips[: later + 1] - tips[0], axis=1).max())
    point.later_m = float(np.linalg.norm(tips[later:] - tips[later], axis=1).max())
    point.error_m = float(np.linalg.norm(tips[-1] - target_m))
    return point


def main() -> None:
    """Measure all arms on all plants and print the table."""
    options = _parser().parse_args()
    print(HEADER)
    for name in options.arms:
        for plant in options.plants:
            points = list[Point]()
            for seed in range(options.seed, options.seed + options.specimens):
                for k, point in enumerate(_points(name, plant, seed, options)):
                    points.append(point)
                    if options.verbose:
                        print(f"{name} {plant} {seed}.{k}: {_line(point)}", file=sys.stderr)
            print(_row(name, plant, points), flush=True)


def _line(point: Point) -> str:
    mm = [1000.0 * x for x in (point.moved_m, point.later_m, point.error_m)]
    text = "{:.2f} s, moved {:.2f}, later {:.2f}, error {:.2f} mm".format(point.settling_s, *mm)
    return "; ".join((text, point.mover, point.failure, *point.notes))


HEADER = """\
| arm | plant | points | errors | settling, median / p95 / most | over 1 s | moved in 2 s, p95 / \
most | over 0.3 mm | moved later, p95 / most | over 0.3 mm | error, median / p95 |
|---|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|"""


def _row(name: str, plant: str, points: Sequence[Point]) -> str:
    settling = np.array([point.settling_s for point in points])
    moved, later, error = (
        1000.0 * np.array([getattr(point, key) for point in points])
        for key in ("moved_m", "later_m", "error_m")
    )
    cells = [
        f"{len(points)}", f"{sum(bool(point.failure) for point in points)}",
        "{:.2f} / {:.2f} / {:.2f} s".format(*np.percentile(settling, (50, 95, 100))),
        f"{int((settling > 1.0).sum())}",
        "{:.2f} / {:.2f} mm".format(*np.percentile(moved, (95, 100))),
        f"{int((moved > 0.3).sum())}",
        "{:.2f} / {:.2f} mm".format(*np.percentile(later, (95, 100))),
        f"{int((later > 0.3).sum())}",
        "{:.2f} / {:.2f} mm".format(*np.percentile(error, (50, 95))),
    ]  # fmt: skip
    return f"| {name} | {plant} | " + " | ".join(cells) + " |"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("arms", nargs="*", default=ARMS, help="names in the catalogue[:volts]")
    parser.add_argument("--plants", nargs="+", default=PLANTS, choices=PLANTS)
    parser.add_argument("--specimens", type=int, default=5, help="arms of each family")
    parser.add_argument("--count", type=int, default=20, help="points per arm")
    parser.add_argument("--speed", default="normal", help="slow, normal or fast")
    parser.add_argument("--seed", type=int, default=1, help="seed of the first arm")
    parser.add_argument("--verbose", action="store_true", help="print each point")
    return parser


if __name__ == "__main__":
    main()
