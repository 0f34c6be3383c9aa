"""Shared code for tests of the lecture's solvers: three methods, arms, and errors."""

from functools import cache

import numpy as np
from hypothesis import strategies as st

from ikservo.ik import Options, Target
from ikservo.ik.jacobian_methods import ResidualFunction
from ikservo.ik.solve import get_method
from ikservo.kinematics import Chain, JointType, Mimic
from ikservo.model import load_model
from tests.kinematics.chains import crane, joint, planar

LECTURE = ("pseudo_inverse", "transpose", "ccd")
DOWNHILL = ("transpose", "ccd")
ARMS = ("planar", "narrow", "crane", "pantograph", "so101", "wx250s")


@cache
def arm(name):
    if name == "planar":
        return planar(0.3, 0.2, 0.1, limit_rad=2.5)
    if name == "narrow":
        return planar(0.3, 0.2, 0.1).with_limits([-0.4, 0.2, -1.0], [0.9, 1.3, 0.1])
    if name == "crane":
        return crane()
    if name == "pantograph":
        return pantograph()
    return load_model(name).chain


def pantograph():
    """Return an arm whose second joint undoes the turn of the first; its tip makes no circle."""
    return Chain.from_joints(
        [
            joint("lift", JointType.REVOLUTE, "base", "a", (0, 0, 0), (0, 0, 1),
                  lower=-1.5, upper=1.5),
            joint("back", JointType.REVOLUTE, "a", "b", (0.3, 0, 0), (0, 0, 1),
                  mimic=Mimic("lift", -2.0, 0.3)),
            joint("wrist", JointType.REVOLUTE, "b", "c", (0.2, 0, 0), (0, 0, 1),
                  lower=-2.0, upper=2.0),
            joint("end", JointType.FIXED, "c", "tip", (0.1, 0, 0)),
        ],
        "base",
        "tip",
    )  # fmt: skip


@st.composite
def joints(draw, chain):
    """Draw joints (dof,) inside the limits, the limits included."""
    parts = draw(st.lists(st.floats(0, 1), min_size=chain.dof, max_size=chain.dof))
    return chain.clip(chain.lower_rad + np.array(parts) * (chain.upper_rad - chain.lower_rad))


@st.composite
def questions(draw, names=ARMS):
    """Draw an arm, a target in or out of reach, and a start."""
    chain = arm(draw(st.sampled_from(names)))
    T = chain.forward(draw(joints(chain)))
    away = np.array(draw(st.tuples(*[st.sampled_from((0.0, 0.0, 0.05, -0.3))] * 3)))
    kind = draw(st.sampled_from(("position", "direction", "pose")))
    return chain, target_at(T, kind, away), draw(joints(chain))


def target_at(T, kind="position", away=(0.0, 0.0, 0.0)):
    position = T[:3, 3] + np.asarray(away)
    if kind == "direction":
        return Target(position, direction=T[:3, 2])
    return Target(position, orientation=T[:3, :3] if kind == "pose" else None)


def walk(method, chain, target, q0, **options):
    """Return the result with its trace."""
    return get_method(method)(chain, target, np.asarray(q0, float), Options(trace=True, **options))


def costs(chain, target, trace):
    """Return |E|² [m²] at every iterate."""
    task = ResidualFunction(chain, target)
    return np.array([task.linearise(q).cost for q in trace])


def near(chain, q, by):
    """Return joints close to q, each by its own amount, inside the limits."""
    return chain.clip(q + by * np.cos(np.arange(chain.dof) * 2.0 + 1.0))
