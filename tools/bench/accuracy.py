"""Error of the true tip at its goal: with correction, and with plain rounding.

Run ``python tools/bench/accuracy.py``; the tables go to docs/benchmarks.md. Simulated arms under
gravity with backlash in every servo move to targets drawn from one seed, in virtual time. The
reference is Pinocchio's forward kinematics of the joints' true positions inside the simulator,
which are finer than any tick; the tables also have the error according to the registers. Plain
rounding executes the same planned motion with the nearest ticks as last goals, then waits two
seconds for rest.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

import ikservo
from ikservo.arm import Arm, MotionPlan, MoveResult
from ikservo.arm.opening import open_own_arm
from ikservo.errors import IkservoError
from ikservo.kinematics.se3 import log_so3
from ikservo.planning.motion_plan import rebase_trajectory

Array = NDArray[np.float64]

ARMS = ("so101", "open_manipulator_x")
REST_S = 2.0


@dataclass(frozen=True)
class Trial:
    """One target, reached or not, with one method.

    Attributes:
        true_m: Distance from the target to the true tip.
        read_m: Distance from the target to the tip at the positions in the registers.
        turned_rad: Angle from the desired to the true orientation of the tool.
        hidden_m: Random error of the tip within the ticks of the joints.
        stretch: Ratio of the motion's duration to the planned one, which is ruckig's optimum.
        settling_s: Time from the end of the motion to rest.
    """

    true_m: float
    read_m: float
    turned_rad: float
    hidden_m: float
    stretch: float = math.nan
    settling_s: float = math.nan


class Judge:
    """Measures the true errors of a simulated arm by the simulator and Pinocchio.

    Args:
        arm: The arm, on a simulated bus.
        seed: Seed of the random errors in ``Trial.hidden_m``.
    """

    def __init__(self, arm: Arm, seed: int) -> None:
        self._pin: Any = import_module("pinocchio")
        self._arm, self._rng = arm, np.random.default_rng(seed)
        self._body: Any = self._pin.buildModelFromUrdf(str(arm.model.path.with_name("arm.urdf")))
        self._data: Any = self._body.createData()
        port: Any = arm.context.port
        self._world: Any = port.transport.line.world

    def trial(
        self, plan: MotionPlan, stretch: float = math.nan, settling_s: float = math.nan
    ) -> Trial:
        """Measure the errors of the arm at its present position."""
        arm = self._arm
        names = [state.name for state in arm.where().joints]
        wanted = arm.chain.forward(plan.goal[[names.index(name) for name in arm.chain.names]])
        tip_m, R = self._truth()
        assert plan.target_m is not None
        return Trial(
            true_m=float(np.linalg.norm(tip_m - plan.target_m)),
            read_m=float(np.linalg.norm(arm.where().tip_m - plan.target_m)),
            turned_rad=float(np.linalg.norm(log_so3(wanted[:3, :3] @ R.T))),
            hidden_m=self._hidden_m(),
            stretch=stretch,
            settling_s=settling_s,
        )

    def _truth(self) -> tuple[Array, Array]:
        q = self._pin.neutral(self._body)
        for joint in self._world.joints:
            q[self._body.joints[self._body.getJointId(joint.name)].idx_q] = joint.position
        self._pin.framesForwardKinematics(self._body, self._data, q)
        pose = self._data.oMf[self._body.getFrameId(self._arm.model.chain.tip)]
        return np.array(pose.translation), np.array(pose.rotation)

    def _hidden_m(self) -> float:
        chain = self._arm.chain
        q = np.array([self._world.joint(name).position for name in chain.names])
        ticks = self._rng.uniform(-0.5, 0.5, chain.dof) * math.tau / 4096
        return float(np.linalg.norm(chain.jacobian(chain.clip(q))[:3] @ ticks))


def main() -> None:
    """Measure all arms and print the tables."""
    options = _parser().parse_args()
    print(ACCURACY)
    times: list[str] = []
    for name in options.arms:
        plain, ours = (list(_trials(name, options, correct=correct)) for correct in (False, True))
        print(_accuracy_row(name, plain, ours), flush=True)
        times.append(_time_row(name, ours))
    print(TIMES, *times, sep="\n")


def _trials(name: str, options: argparse.Namespace, *, correct: bool) -> Iterator[Trial]:
    port = f"sim:?backlash_deg={options.backlash_deg}&seed={options.seed}"
    with open_own_arm(ikservo.load_model(name), port) as arm:
        judge = Judge(arm, options.seed)
        for count, plan in enumerate(_plans(arm, options.seed, options.speed)):
            if count == options.count:
                return
            yield _corrected(arm, judge, plan) if correct else _plain(arm, judge, plan)
            print(f"\r{name} {count + 1}", end="", file=sys.stderr)


def _plans(arm: Arm, seed: int, speed: str) -> Iterator[MotionPlan]:
    """Yield endless plans to random points that the arm reaches without contact."""
    rng = np.random.default_rng(seed)
    while True:
        q = rng.uniform(arm.chain.lower_rad, arm.chain.upper_rad)
        try:
            yield arm.plan_to(arm.chain.forward(q)[:3, 3], speed=speed)
        except IkservoError:
            continue


def _corrected(arm: Arm, judge: Judge, plan: MotionPlan) -> Trial:
    report = cast("MoveResult", arm.execute(plan))  # the result of a plan of the tip
    return judge.trial(plan, report.motion_s / plan.duration_s, report.settling_s)


def _plain(arm: Arm, judge: Judge, plan: MotionPlan) -> Trial:
    """Execute the same plan without the correction at the goal."""
    context, runner = arm.context, arm.runner
    servos, limits = context.servos, context.planner.motion_limits(plan.speed)
    with runner.motion():
        runner.loop.run(rebase_trajectory(plan, servos.goals(), limits, servos.names))
    servos.clock.sleep_until(servos.clock.now_s() + REST_S)
    return judge.trial(plan)


ACCURACY = """\
| arm | targets | plain rounding: true error, median / p95 | corrected: true error, median / p95 \
| corrected / plain | corrected, by the registers | hidden in the sensors' ticks \
| tool turned: plain, corrected |
|---|---:|---:|---:|---:|---:|---:|---:|"""


def _accuracy_row(name: str, plain: Sequence[Trial], ours: Sequence[Trial]) -> str:
    ratio = _median(t.true_m for t in ours) / _median(t.true_m for t in plain)
    turned = [f"{math.degrees(_median(t.turned_rad for t in side)):.2f}°" for side in (plain, ours)]
    return (
        f"| {name} | {len(ours)} | {_mm(t.true_m for t in plain)} | {_mm(t.true_m for t in ours)} "
        f"| {ratio:.2f} | {_mm(t.read_m for t in ours)} | {_mm(t.hidden_m for t in ours)} "
        f"| {', '.join(turned)} |"
    )


TIMES = """
| arm | motion / planned optimum, median / p95 / most | settling, median / p95 / most |
|---|---:|---:|"""


def _time_row(name: str, ours: Sequence[Trial]) -> str:
    stretch, settling = [np.array([getattr(t, f) for t in ours]) for f in ("stretch", "settling_s")]
    shares = " / ".join(f"{x:.3f}" for x in np.percentile(stretch, (50, 95, 100)))
    seconds = " / ".join(f"{x:.2f}" for x in np.percentile(settling, (50, 95, 100)))
    return f"| {name} | {shares} | {seconds} s |"


def _mm(metres: Iterable[float]) -> str:
    return " / ".join(f"{1000 * x:.2f}" for x in np.percentile(list(metres), (50, 95))) + " mm"


def _median(values: Iterable[float]) -> float:
    return float(np.median(list(values)))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("arms", nargs="*", default=ARMS, help="names in the catalogue")
    parser.add_argument("--count", type=int, default=500, help="targets per arm")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--speed", default="normal", help="slow, normal or fast")
    parser.add_argument("--backlash-deg", type=float, default=0.5, help="backlash of every servo")
    return parser


if __name__ == "__main__":
    main()
