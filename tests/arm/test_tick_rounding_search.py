"""Whole ticks near a solution: inside limits, no worse than rounding, deterministic."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ikservo
from ikservo.calibration import JointMap, Limits
from ikservo.guard import DrivenJoint
from ikservo.settling.tick_rounding import round_to_ticks
from tests.oracle import ARMS

CHAINS = {name: ikservo.load_model(name).chain for name in ARMS}
DRAWS = st.lists(st.floats(0.0, 1.0), min_size=8, max_size=8)


def driven_joints_of(chain):
    return [
        DrivenJoint(
            JointMap.revolute(name, i, (-1) ** i, 2048 + 0.3 * i, 4096),
            Limits.of(name, float(low), float(high), "arm file"),
            speed=2.0,
        )
        for i, (name, low, high) in enumerate(
            zip(chain.names, chain.lower_rad, chain.upper_rad, strict=True), start=1
        )
    ]


def drawn(name, draws):
    chain = CHAINS[name]
    share = np.array(draws[: chain.dof])
    return chain, chain.lower_rad + share * (chain.upper_rad - chain.lower_rad)


def tip_m(chain, driven_joints, ticks):
    joints = [
        driven.joint_map.position(tick) for driven, tick in zip(driven_joints, ticks, strict=True)
    ]
    return chain.forward(joints)[:3, 3]


@pytest.mark.parametrize("name", ARMS)
@settings(max_examples=8, deadline=None)
@given(draws=DRAWS)
def test_tick_rounding_search_stays_inside_joint_limits(name, draws):
    chain, q = drawn(name, np.round(draws))  # every joint on one of its limits
    driven_joints = driven_joints_of(chain)
    ticks = round_to_ticks(chain, chain.forward(q)[:3, 3], q, driven_joints)
    for driven, tick in zip(driven_joints, ticks, strict=True):
        assert driven.tick_range[0] <= tick <= driven.tick_range[1]


@pytest.mark.parametrize("name", ARMS)
@settings(max_examples=8, deadline=None)
@given(draws=DRAWS)
def test_tick_rounding_search_is_never_worse_than_plain_rounding(name, draws):
    chain, q = drawn(name, draws)
    driven_joints, target_m = driven_joints_of(chain), chain.forward(q)[:3, 3]
    inside = [
        min(max(driven.tick(x), driven.tick_range[0]), driven.tick_range[1])
        for driven, x in zip(driven_joints, q, strict=True)
    ]
    ticks = round_to_ticks(chain, target_m, q, driven_joints)
    turned_m = 0.01 * math.radians(1.0)  # rounding turns the tool by less than a degree
    rounded = np.linalg.norm(tip_m(chain, driven_joints, inside) - target_m)
    assert np.linalg.norm(tip_m(chain, driven_joints, ticks) - target_m) <= rounded + turned_m


@pytest.mark.parametrize("name", ["so101", "wx250s"])
def test_tick_rounding_search_halves_error_of_plain_rounding(name):
    chain, rng = CHAINS[name], np.random.default_rng(5)
    driven_joints = driven_joints_of(chain)
    ours, rounded = [], []
    for q in rng.uniform(chain.lower_rad, chain.upper_rad, (25, chain.dof)):
        target_m = chain.forward(q)[:3, 3]
        nearest = [driven.tick(x) for driven, x in zip(driven_joints, q, strict=True)]
        rounded.append(np.linalg.norm(tip_m(chain, driven_joints, nearest) - target_m))
        ticks = round_to_ticks(chain, target_m, q, driven_joints)
        ours.append(np.linalg.norm(tip_m(chain, driven_joints, ticks) - target_m))
    assert np.median(ours) < 0.5 * np.median(rounded)


def test_tick_rounding_search_keeps_orientation_within_0_5_deg():
    chain, rng = CHAINS["wx250s"], np.random.default_rng(6)
    driven_joints = driven_joints_of(chain)
    for q in rng.uniform(chain.lower_rad, chain.upper_rad, (10, chain.dof)):
        T = chain.forward(q)
        ticks = round_to_ticks(chain, T[:3, 3], q, driven_joints)
        joints = [
            driven.joint_map.position(tick)
            for driven, tick in zip(driven_joints, ticks, strict=True)
        ]
        cos = (np.trace(chain.forward(joints)[:3, :3].T @ T[:3, :3]) - 1.0) / 2.0
        assert math.degrees(math.acos(min(1.0, cos))) < 0.5


def test_tick_rounding_search_is_deterministic():
    chain, q = drawn("so101", [0.3, 0.6, 0.4, 0.7, 0.2, 0.5, 0.5, 0.5])
    asked = (chain, chain.forward(q)[:3, 3], q, driven_joints_of(chain))
    assert round_to_ticks(*asked) == round_to_ticks(*asked)
