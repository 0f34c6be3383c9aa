"""Plans as messages: what a plan says, and its path, which stays beside the arm until asked for."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import cast

import numpy as np
from pydantic import BaseModel, ConfigDict

from ikservo.arm import MotionPlan
from ikservo.arm.plan import NearLimit
from ikservo.arm.result_json import FloatArray
from ikservo.arm.tool_speed import ToolSpeed
from ikservo.errors import RefusedError
from ikservo.ik import Result
from ikservo.ik.result import ActiveLimit
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.motion import TrajectoryPoint

__all__ = ["PlanFields", "PlanRegistry", "RemoteTrajectory", "SampleFields", "plan_from_fields"]

_MAX_PLANS = 32
_MAX_SAMPLES = 4000
_STEP_S = 0.01


class _Fields(BaseModel):
    model_config = ConfigDict(
        extra="forbid", arbitrary_types_allowed=True, ser_json_inf_nan="strings"
    )


class SolutionFields(_Fields):
    """The solver's result of a plan, without its iterates."""

    q: FloatArray
    reached: bool
    position_error_m: float
    orientation_error_rad: float
    binding: tuple[ActiveLimit, ...]
    iterations: int
    nearest_m: FloatArray
    method: str


class PlanFields(_Fields):
    """A plan without its path; see ``MotionPlan``."""

    plan: str
    start: FloatArray
    goal: FloatArray
    tip_m: FloatArray
    path_m: float
    duration_s: float
    speed: str
    time_limiting_joints: tuple[str, ...]
    near_limits: tuple[NearLimit, ...]
    target_m: FloatArray | None
    solution: SolutionFields | None
    orientation_error_rad: float
    orientation_requested: bool
    orientation_change_rad: float
    speed_reduced: bool
    is_cartesian: bool
    cartesian_s: float
    tool_speed: ToolSpeed | None
    via_pose: str
    names: tuple[str, ...]
    units: tuple[str, ...]


_PLAIN = tuple(name for name in PlanFields.model_fields if name not in ("plan", "solution"))


class SampleFields(_Fields):
    """The path of a plan at equal time steps: positions and velocities (k, n)."""

    step_s: float
    positions: FloatArray
    velocities: FloatArray


class PlanRegistry:
    """The latest plans of an arm, by an id; older ones are forgotten."""

    def __init__(self) -> None:
        self._plans: OrderedDict[str, MotionPlan] = OrderedDict()
        self._count = 0

    def __len__(self) -> int:
        """Return how many are kept."""
        return len(self._plans)

    def add(self, plan: MotionPlan) -> PlanFields:
        """Keep a plan; return what it says."""
        self._count += 1
        name = f"{self._count:x}"
        self._plans[name] = plan
        while len(self._plans) > _MAX_PLANS:
            self._plans.popitem(last=False)
        solution = None
        if plan.solution is not None:
            known = SolutionFields.model_fields
            solution = SolutionFields(**{key: getattr(plan.solution, key) for key in known})
        plain = {key: getattr(plan, key) for key in _PLAIN}
        return PlanFields(plan=name, solution=solution, **plain)

    def get(self, name: str) -> MotionPlan:
        """Get a plan.

        Raises:
            RefusedError: It is not kept, or no longer.
        """
        if name not in self._plans:
            raise RefusedError(
                "That plan is no longer kept there.", "Nothing was sent. Plan again."
            )
        return self._plans[name]

    def sample(self, name: str) -> SampleFields:
        """Sample the path of a plan.

        Raises:
            RefusedError: It is not kept, or no longer.
        """
        plan = self.get(name)
        step_s = max(_STEP_S, plan.duration_s / _MAX_SAMPLES)
        count = int(np.ceil(plan.duration_s / step_s)) + 1
        states = [plan.trajectory.state(min(i * step_s, plan.duration_s)) for i in range(count)]
        return SampleFields(
            step_s=step_s,
            positions=np.array([state.position for state in states]),
            velocities=np.array([state.velocity for state in states]),
        )


class RemoteTrajectory:
    """The path of a plan that is kept beside the arm; fetched when first looked at.

    Args:
        plan: The id of the plan.
        duration_s: Its duration.
        fetch: Returns the samples.
    """

    def __init__(self, plan: str, duration_s: float, fetch: Callable[[], SampleFields]) -> None:
        self.plan, self._duration_s, self._fetch = plan, duration_s, fetch
        self._samples: SampleFields | None = None

    @property
    def duration_s(self) -> float:
        """Its duration."""
        return self._duration_s

    def state(self, time_s: float) -> TrajectoryPoint:
        """Return position, velocity and acceleration (n,): cubic between the samples."""
        if self._samples is None:
            self._samples = self._fetch()
        positions, velocities = (
            cast("Matrix", each) for each in (self._samples.positions, self._samples.velocities)
        )
        if time_s >= self._duration_s or len(positions) < 2:
            return TrajectoryPoint.at_rest(positions[-1])
        step_s = self._samples.step_s
        index = min(max(int(time_s / step_s), 0), len(positions) - 2)
        width_s = min(step_s, self._duration_s - index * step_s)
        ends = (positions[index], positions[index + 1], velocities[index], velocities[index + 1])
        return _hermite(*ends, max(0.0, time_s - index * step_s) / width_s, width_s)


def _hermite(
    p0: Vector, p1: Vector, v0: Vector, v1: Vector, u: float, width_s: float
) -> TrajectoryPoint:
    """Compute the cubic with given ends and velocities (n,) at a fraction ``u`` of its width."""
    a, b = v0 * width_s, v1 * width_s
    c2, c3 = 3.0 * (p1 - p0) - 2.0 * a - b, 2.0 * (p0 - p1) + a + b
    return TrajectoryPoint(
        p0 + u * (a + u * (c2 + u * c3)),
        (a + u * (2.0 * c2 + u * 3.0 * c3)) / width_s,
        (2.0 * c2 + 6.0 * u * c3) / width_s**2,
    )


def plan_from_fields(fields: PlanFields, fetch: Callable[[str], SampleFields]) -> MotionPlan:
    """Return the plan that a server keeps, with a path that is fetched when needed."""
    solution = fields.solution
    given = {} if solution is None else {key: getattr(solution, key) for key in
                                         SolutionFields.model_fields}  # fmt: skip
    return MotionPlan(
        trajectory=RemoteTrajectory(fields.plan, fields.duration_s, lambda: fetch(fields.plan)),
        solution=None if solution is None else Result(**given),
        **{key: getattr(fields, key) for key in _PLAIN},
    )
