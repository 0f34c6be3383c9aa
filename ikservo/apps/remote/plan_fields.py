"""Plans as messages: fields of a plan, and its path, which stays on the server until requested."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import JsonValue

from ikservo.arm import MotionPlan
from ikservo.arm.result_json import decode_fields, encode_fields
from ikservo.errors import RefusedError
from ikservo.ik import Result
from ikservo.kinematics.arrays import Matrix
from ikservo.motion import TrajectoryPoint
from ikservo.planning.motions import MotionValue
from ikservo.serving.replies import other_version_error

_MAX_PLANS = 32
_MAX_SAMPLES = 4000
_STEP_S = 0.01

_KEPT_THERE = ("trajectory", "solution", "motion", "requested", "clamped", "limp_arm")
_ITERATES = ("trace", "question")
"""Fields of a plan and its solution that are not sent."""


@dataclass(frozen=True, slots=True, eq=False)
class PathSamples:
    """The path of a plan at equal time steps.

    Attributes:
        step_s: Time between two samples.
        positions: The positions of all joints (k, n), rad or m.
        velocities: The velocities of all joints (k, n).
    """

    step_s: float
    positions: Matrix
    velocities: Matrix


class PlanRegistry:
    """The latest plans of an arm, by id; older plans are dropped."""

    def __init__(self) -> None:
        self._plans: OrderedDict[str, MotionPlan] = OrderedDict()
        self._count = 0

    def __len__(self) -> int:
        """Return the number of stored plans."""
        return len(self._plans)

    def add(self, plan: MotionPlan) -> dict[str, JsonValue]:
        """Store a plan; return its fields."""
        self._count += 1
        name = f"{self._count:x}"
        self._plans[name] = plan
        while len(self._plans) > _MAX_PLANS:
            self._plans.popitem(last=False)
        solution = plan.solution and encode_fields(plan.solution, _ITERATES)
        return {"plan": name, "solution": solution, **encode_fields(plan, _KEPT_THERE)}

    def get(self, name: str) -> MotionPlan:
        """Return a plan.

        Raises:
            RefusedError: The plan is unknown, or has been dropped.
        """
        if name not in self._plans:
            raise RefusedError(
                "The server no longer keeps that plan.", "Nothing was sent. Plan again."
            )
        return self._plans[name]

    def sample(self, name: str) -> PathSamples:
        """Sample the path of a plan.

        Raises:
            RefusedError: The plan is unknown, or has been dropped.
        """
        plan = self.get(name)
        step_s = max(_STEP_S, plan.duration_s / _MAX_SAMPLES)
        count = int(np.ceil(plan.duration_s / step_s)) + 1
        states = [plan.trajectory.state(min(i * step_s, plan.duration_s)) for i in range(count)]
        return PathSamples(
            step_s=step_s,
            positions=np.array([state.position for state in states]),
            velocities=np.array([state.velocity for state in states]),
        )


class RemoteTrajectory:
    """The path of a plan that is kept on the server; fetched at the first access.

    Args:
        plan: The id of the plan.
        duration_s: The duration of the path.
        fetch: Function that returns the samples.
    """

    def __init__(self, plan: str, duration_s: float, fetch: Callable[[], PathSamples]) -> None:
        self.plan, self.duration_s, self._fetch = plan, duration_s, fetch
        self._samples: PathSamples | None = None

    def state(self, time_s: float) -> TrajectoryPoint:
        """Interpolate position, velocity and acceleration (n,) by cubics between the samples."""
        if self._samples is None:
            self._samples = self._fetch()
        positions, velocities = self._samples.positions, self._samples.velocities
        if time_s >= self.duration_s or len(positions) < 2:
            return TrajectoryPoint.at_rest(positions[-1])
        step_s = self._samples.step_s
        index = min(max(int(time_s / step_s), 0), len(positions) - 2)
        width_s = min(step_s, self.duration_s - index * step_s)
        p0, p1 = positions[index : index + 2]
        a, b = width_s * velocities[index], width_s * velocities[index + 1]
        u = max(0.0, time_s - index * step_s) / width_s
        c2, c3 = 3.0 * (p1 - p0) - 2.0 * a - b, 2.0 * (p0 - p1) + a + b
        return TrajectoryPoint(
            p0 + u * (a + u * (c2 + u * c3)),
            (a + u * (2.0 * c2 + u * 3.0 * c3)) / width_s,
            (2.0 * c2 + 6.0 * u * c3) / width_s**2,
        )


def plan_from_fields(
    fields: Mapping[str, Any], motion: MotionValue[Any], fetch: Callable[[str], PathSamples]
) -> MotionPlan:
    """Make a plan that is kept by a server, with a path that is fetched when needed.

    The fields are from ``PlanRegistry.add`` on the server; ``fetch`` returns samples by plan id.

    Raises:
        IkservoError: The fields are from a different version of ikservo.
    """
    match fields:
        case {"plan": str(name), "solution": solution, "duration_s": float(duration_s), **plain}:
            path = RemoteTrajectory(name, duration_s, lambda: fetch(name))
        case _:
            raise other_version_error()
    given = dict.fromkeys(_ITERATES) | {"trace": ()}
    return decode_fields(
        MotionPlan,
        {**plain, "duration_s": duration_s},
        {
            "trajectory": path,
            "solution": solution and decode_fields(Result, solution, given),
            "motion": motion,
            "requested": {},
            "clamped": (),
            "limp_arm": None,
        },
    )
