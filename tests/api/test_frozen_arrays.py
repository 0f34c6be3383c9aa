"""Returned arrays and mappings of frozen values cannot be written to."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest

import ikservo
from ikservo.errors import RefusedError


def writable_parts(value, path, seen=None):
    """Yield the paths of arrays and dicts below a frozen value that can be changed."""
    seen = set() if seen is None else seen
    if id(value) in seen:
        return
    seen.add(id(value))
    if isinstance(value, np.ndarray):
        if value.flags.writeable:
            yield path
    elif isinstance(value, Mapping):
        for key, part in value.items():
            yield from writable_parts(part, f"{path}[{key!r}]", seen)
    elif isinstance(value, (tuple, list)):
        for i, part in enumerate(value):
            yield from writable_parts(part, f"{path}[{i}]", seen)
    elif is_dataclass(value) and value.__dataclass_params__.frozen:
        for field in fields(value):
            yield from writable_parts(getattr(value, field.name), f"{path}.{field.name}", seen)


@pytest.fixture(scope="module")
def arm():
    with ikservo.open_arm("so101", port="sim") as opened:
        opened.pose("home")
        yield opened


VALUES = {
    "a model": lambda arm: arm.model,
    "a chain": lambda arm: arm.chain,
    "a solution": lambda arm: ikservo.solve(arm.chain, ikservo.Target((0.25, 0.05, 0.15))),
    "solutions": lambda arm: ikservo.solve_batch(arm.chain, [(0.25, 0.05, 0.15)] * 2),
    "a plan": lambda arm: arm.plan_to((0.25, 0.05, 0.15)),
    "a plan of joints": lambda arm: arm.plan_joints({"shoulder_pan": 0.1}),
    "a line": lambda arm: arm.plan_line((0.25, 0.02, 0.15)),
    "samples": lambda arm: arm.plan_to((0.25, 0.05, 0.15)).sample(),
    "a point of a trajectory": lambda arm: arm.plan_to((0.25, 0.05, 0.15)).trajectory.state(0.1),
    "a state": lambda arm: arm.where(),
    "a result": lambda arm: arm.move_to((0.25, 0.05, 0.15)),
    "a result of joints": lambda arm: arm.move_joints({"shoulder_pan": 0.1}),
    "limits": lambda arm: arm.limits(),
    "a control cycle": lambda arm: arm.runner.loop.last_cycle,
}


@pytest.mark.full
@pytest.mark.parametrize("make", VALUES.values(), ids=VALUES)
def test_arrays_of_returned_values_are_read_only(arm, make):
    assert list(writable_parts(make(arm), "value")) == []


SHARED = {
    "points of trajectories": lambda arm: [
        plan.trajectory.state(at_s)
        for plan in (arm.plan_joints({"shoulder_pan": 0.1}), arm.plan_line((0.25, 0.02, 0.15)))
        for at_s in (-1.0, 0.0, 0.1, plan.duration_s, plan.duration_s + 1.0)
    ],
    "poses of links": lambda arm: arm.chain.link_poses(arm.chain.mid_range()),
    "the middle of the range": lambda arm: arm.chain.mid_range(),
    "first joints": lambda arm: arm.model.initial_joints(),
}


@pytest.mark.full
@pytest.mark.sample(2)
@pytest.mark.parametrize("make", SHARED.values(), ids=SHARED)
def test_writable_arrays_returned_twice_do_not_share_memory(arm, make):
    first, second = (list(arrays_of(make(arm))) for _ in range(2))
    assert first
    for one, other in zip(first, second, strict=True):
        assert not (one.flags.writeable and np.shares_memory(one, other))


def arrays_of(value):
    """Yield the arrays in a value."""
    if isinstance(value, np.ndarray):
        yield value
    elif isinstance(value, Mapping):
        yield from arrays_of(list(value.values()))
    elif isinstance(value, (tuple, list)):
        for part in value:
            yield from arrays_of(part)
    elif is_dataclass(value):
        yield from arrays_of([getattr(value, field.name) for field in fields(value)])


def test_changing_input_array_does_not_change_plan(arm):
    plan, goal = arm.plan_joints({"shoulder_pan": 0.1}), np.zeros(6)
    changed = replace(plan, goal=goal)
    goal[1] += 1.0
    assert changed.goal[1] == 0.0


def test_plan_with_goal_different_from_its_end_is_refused(arm):
    plan = arm.plan_to((0.25, 0.05, 0.15))
    with pytest.raises(RefusedError, match="goal differs from the end of its trajectory"):
        arm.execute(replace(plan, goal=plan.goal + np.array([0.0, 0.3, 0.0, 0.0, 0.0, 0.0])))


def test_model_pose_mapping_is_read_only():
    with pytest.raises(TypeError):
        ikservo.load_model("so101").pose("home")["shoulder_lift"] = 9.0
