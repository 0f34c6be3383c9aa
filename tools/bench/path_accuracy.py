"""Measure the path accuracy of straight lines: distances of the true tip from the line.

Run ``python tools/bench/path_accuracy.py``; the table goes to docs/benchmarks.md. Simulated arms
of a family (``servosim.family``), each with its own backlash, friction, masses and supply, move
along random lines in virtual time. The reference is the simulator's true joints, not the arm's
readings. It measures the distance of the tip from the commanded line in each control cycle, its
distance from the target at the end of the trajectory and after settling, and the motion of joints
later than one second after the end. ``--mass-scale`` and ``--payload-kg`` change the simulated body
only: the program does not know it. ``--supply-v 12`` is the so101 with servos of 12 V.
"""

from __future__ import annotations

import argparse
import math
import re
import shutil
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

import ikservo
from ikservo.arm import Arm, MotionPlan, MotionProgress, MoveResult
from ikservo.arm.opening import open_own_arm
from ikservo.errors import IkservoError, NotSettledError
from ikservo.planning.reports import OnProgress

Array = NDArray[np.float64]

ARMS = ("so101", "koch", "open_manipulator_x", "px100", "wx250s", "vx300s")
SPEEDS = ("slow", "normal", "fast")
SHORTEST_M, LONGEST_M = 0.05, 0.25
ATTEMPTS = 60  # directions tried from one posture
LOWEST_M = 0.05  # lines begin above this height, because few directions are free below it
SAMPLE_S = 0.01
REST_S, WATCHED_S = 1.0, 1.0  # wait after the end, then watch for further motion
STILL_TICKS = 2.0  # a joint that moves no further than this rests


@dataclass
class Trace:
    """One line and the motion of the simulated joints along it.

    Attributes:
        start_m: Start of the commanded line (3,).
        end_m: Its end.
        duration_s: Duration of the planned trajectory.
        times_s: Time of the trajectory at each sample.
        tips_m: True tip at each sample, (3,) each.
        overshoot_rad: Largest angle by which a joint passed its target while settling; on lines,
            by which it passed its rest position, because other joints compensate a joint that
            stays short.
        settling_s: Time from the end of the trajectory to rest.
        settled_m: The tip's distance from the target after settling.
        moved_ticks: Largest motion of a joint later than one second after the end.
        failure: Reason why the motion was stopped; empty if it was not.
    """

    start_m: Array
    end_m: Array
    duration_s: float
    times_s: list[float] = field(default_factory=list[float])
    tips_m: list[Array] = field(default_factory=list[Array])
    overshoot_rad: float = 0.0
    settling_s: float = math.nan
    settled_m: float = math.nan
    moved_ticks: float = math.nan
    failure: str = ""

    def deviations_m(self, after_s: float = 0.0) -> Array:
        """Return the distances of the tip from the line (k,) after a given time."""
        late = np.array(self.times_s) >= min(after_s, self.duration_s)
        ahead = np.array(self.tips_m)[late] - self.start_m
        way = self.end_m - self.start_m
        along = np.clip(ahead @ way / (way @ way), 0.0, 1.0)
        return np.linalg.norm(ahead - along[:, None] * way, axis=1)

    def end_error_m(self) -> float:
        """Return the tip's distance from the target at the end of the trajectory."""
        return float(np.linalg.norm(self.tips_m[-1] - self.end_m))


class Observer:
    """Samples the simulated joints of an arm while it moves."""

    def __init__(self, arm: Arm) -> None:
        self._arm = arm
        port: Any = arm.context.port
        self._world: Any = port.transport.line.world

    def tip_m(self) -> Array:
        """Return the true tip (3,)."""
        return self._arm.chain.forward(self.joints())[:3, 3]

    def joints(self) -> Array:
        """Return the true joints of the chain (dof,)."""
        return np.array([self._world.joint(name).position for name in self._arm.chain.names])

    def trace(self, plan: MotionPlan) -> Trace:
        """Execute a line and return what the joints did."""
        assert plan.target_m is not None
        columns = [plan.names.index(name) for name in self._arm.chain.names]
        start, goal = plan.start[columns], plan.goal[columns]
        forward = self._arm.chain.forward
        trace = Trace(forward(start)[:3, 3], forward(goal)[:3, 3], plan.duration_s)
        arrival, aim, side = list[Array](), goal, np.zeros_like(goal)

        def sample(progress: MotionProgress) -> None:
            at = self.joints()
            trace.times_s.append(progress.elapsed_s)
            trace.tips_m.append(forward(at)[:3, 3])
            if progress.elapsed_s >= plan.duration_s:
                side[:] = np.sign(goal - at)
                self._watch_arrival(trace, arrival)

        try:
            report = self._executed(plan, sample)
            trace.settling_s = report.settling_s
            if plan.solution is not None and len(report.binding) > len(plan.solution.binding):
                aim = np.where(side * (self.joints() - goal) > 0.0, self.joints(), goal)
        except NotSettledError:
            trace.settling_s = math.inf
        except IkservoError as error:
            trace.failure, trace.settling_s = error.message, math.inf
            self._arm.acknowledge()
        trace.overshoot_rad = float(np.max(side * (np.array([goal, *arrival]) - aim), initial=0.0))
        trace.settled_m = float(np.linalg.norm(self.tip_m() - trace.end_m))
        trace.moved_ticks = self._moved_ticks()
        return trace

    def _moved_ticks(self) -> float:
        """Wait, then watch; return the largest distance that a joint moves meanwhile."""
        clock, seen = self._arm.context.port.clock, list[Array]()
        clock.sleep_until(clock.now_s() + REST_S)
        for _ in range(round(WATCHED_S / SAMPLE_S)):
            clock.sleep_until(clock.now_s() + SAMPLE_S)
            self._arm.where()  # the simulated line follows its host
            seen.append(self.joints())
        maps = {driven.joint: driven.joint_map for driven in self._arm.context.servos.driven_joints}
        ticks = np.array([maps[name].unit_per_tick for name in self._arm.chain.names])
        return float(np.max(np.ptp(seen, axis=0) / ticks))

    def _watch_arrival(self, trace: Trace, arrival: list[Array]) -> None:
        """Collect the joints (dof,) from now on until they have settled."""
        arrival.append(self.joints())
        if math.isnan(trace.settling_s):
            again_s = self._world.time_s + SAMPLE_S
            self._world.schedule(again_s, lambda: self._watch_arrival(trace, arrival))

    def _executed(self, plan: MotionPlan, sample: OnProgress) -> MoveResult:
        return cast("MoveResult", self._arm.execute(plan, sample))  # as for all tip plans


def main() -> None:
    """Measure all arms at all speeds and print the table."""
    options = _parser().parse_args()
    print(HEADER)
    for name in options.arms:
        for speed in options.speeds:
            traces = list(_traces(name, speed, options))
            print(_row(name, speed, traces, options.after_s), flush=True)
            for trace in traces:
                if trace.failure:
                    print(f"{name} {speed}: {trace.failure}", file=sys.stderr)


def _traces(name: str, speed: str, options: argparse.Namespace) -> Iterator[Trace]:
    with tempfile.TemporaryDirectory() as folder:
        known = ikservo.load_model(name).path
        if options.supply_v:
            known = supplied(known, Path(folder) / "known", options.supply_v)
        body = _changed_body(known, Path(folder), options.mass_scale, options.payload_kg)
        for seed in range(options.seed, options.seed + options.specimens):
            port = f"sim:{body}?seed={seed}"
            with open_own_arm(ikservo.load_model(known), port, uncalibrated=True) as arm:
                observer, rng = Observer(arm), np.random.default_rng(seed)
                move_away(arm, rng)
                for _ in range(options.count):
                    yield observer.trace(next_line(arm, rng, speed))
            print(f"\r{name} {speed} arm {seed} ", end="", file=sys.stderr)


def next_line(arm: Arm, rng: np.random.Generator, speed: str) -> MotionPlan:
    """Plan a line from the present position, or from another one if no line is free there."""
    while True:
        for _ in range(ATTEMPTS):
            way_m = rng.uniform(SHORTEST_M, LONGEST_M) * _direction(rng)
            try:
                plan = arm.plan_line(arm.where().tip_m + way_m, speed=speed)
            except IkservoError:
                continue
            if not plan.via_pose:  # a folded arm first moves elsewhere
                return plan
        move_away(arm, rng)


def move_away(arm: Arm, rng: np.random.Generator) -> None:
    """Move to a random posture with the tip well above the table."""
    names = arm.chain.names
    while True:
        q = rng.uniform(arm.chain.lower_rad, arm.chain.upper_rad)
        try:
            arm.move_joints(dict(zip(names, q.tolist(), strict=True)), speed="fast")
            if arm.where().tip_m[2] < LOWEST_M:
                continue
        except IkservoError:
            arm.acknowledge()
            continue
        return


def _direction(rng: np.random.Generator) -> Array:
    way = rng.normal(size=3)
    return way / np.linalg.norm(way)


def supplied(known: Path, folder: Path, supply_v: float) -> Path:
    """Return an arm file with another supply, with which an STS3215 has another motor."""
    shutil.copytree(known.parent, folder)
    text = re.sub(r"(?m)^supply_v = [\d.]+", f"supply_v = {supply_v}", known.read_text())
    (folder / known.name).write_text(text)
    return folder / known.name


def _changed_body(known: Path, folder: Path, mass_scale: float, payload_kg: float) -> Path:
    """Return an arm file whose links have other masses, and its tip a payload."""
    model = ikservo.load_model(str(known))
    own = folder / "body"
    shutil.copytree(known.parent, own)
    urdf = own / "arm.urdf"
    text = re.sub(
        r'(<mass\s+value=")([^"]+)"',
        lambda found: f'{found[1]}{float(found[2]) * mass_scale}"',
        urdf.read_text(),
    )
    if mass_scale != 1.0:
        text = re.sub(r"<inertia\s[^>]*>", lambda found: _scaled(found[0], mass_scale), text)
    if payload_kg:
        text = text.replace("</robot>", _payload(model.chain.tip, payload_kg) + "</robot>")
    urdf.write_text(text)
    return own / "arm.toml"


def _scaled(element: str, factor: float) -> str:
    return re.sub(r'"([^"]+)"', lambda found: f'"{float(found[1]) * factor}"', element)


def _payload(tip: str, mass_kg: float) -> str:
    tensor = " ".join(f'{axis}="1e-6"' for axis in ("ixx", "iyy", "izz"))
    return (
        f'<joint name="payload" type="fixed"><parent link="{tip}"/><child link="payload"/></joint>'
        f'<link name="payload"><inertial><mass value="{mass_kg}"/>'
        f'<inertia {tensor} ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )


HEADER = """\
| arm | speed | lines | error beside a line, rms: median / p95 | most | at its end, before \
settling, median / p95 | settled, median / p95 | settling, median / p95 | overshoot | still moving \
| in an error |
|---|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|"""


def _row(name: str, speed: str, traces: Sequence[Trace], after_s: float) -> str:
    beside = [trace.deviations_m(after_s) for trace in traces if trace.times_s]
    rms = [math.sqrt(float(np.mean(each**2))) for each in beside]
    most_mm = 1000 * max(float(each.max()) for each in beside)
    whole = [trace for trace in traces if math.isfinite(trace.settling_s)]
    settling = " / ".join(
        f"{x:.2f}" for x in np.percentile([t.settling_s for t in whole], (50, 95))
    )
    overshoot = math.degrees(max(trace.overshoot_rad for trace in whole))
    return (
        f"| {name} | {speed} | {len(traces)} | {_mm(rms, (50, 95))} | {most_mm:.2f} mm "
        f"| {_mm([t.end_error_m() for t in whole], (50, 95))} "
        f"| {_mm([t.settled_m for t in whole], (50, 95))} | {settling} s "
        f"| {overshoot:.2f}° | {sum(t.moved_ticks > STILL_TICKS for t in traces)} "
        f"| {len(traces) - len(whole)} |"
    )


def _mm(metres: Sequence[float], shares: tuple[int, ...]) -> str:
    return " / ".join(f"{1000 * x:.2f}" for x in np.percentile(metres, shares)) + " mm"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("arms", nargs="*", default=ARMS, help="names in the catalogue")
    parser.add_argument("--specimens", type=int, default=50, help="arms of each family")
    parser.add_argument("--count", type=int, default=2, help="lines per arm and speed")
    parser.add_argument("--speeds", nargs="+", default=SPEEDS, choices=SPEEDS)
    parser.add_argument("--seed", type=int, default=1, help="seed of the first arm")
    parser.add_argument("--mass-scale", type=float, default=1.0, help="factor of simulated masses")
    parser.add_argument("--payload-kg", type=float, default=0.0, help="mass at the simulated tip")
    parser.add_argument("--supply-v", type=float, help="supply, known to the program")
    parser.add_argument("--after-s", type=float, default=0.0, help="judge the path after this")
    return parser


if __name__ == "__main__":
    main()
