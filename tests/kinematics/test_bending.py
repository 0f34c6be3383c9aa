"""Compliant arms bend equally in ikservo and in the separately written servosim."""

from dataclasses import replace

import numpy as np
import pytest

from ikservo.kinematics import Dynamics
from ikservo.kinematics.bending_and_backlash import Bending
from ikservo.model import load_model
from ikservo.model.arm_model import link_masses
from servosim import read_arm_file
from servosim.assembly import make_arm_world
from servosim.specimen import Specimen


def random_joints(chain, count):
    low, high = np.maximum(chain.lower_rad, -2.0), np.minimum(chain.upper_rad, 2.0)
    return np.random.default_rng(1).uniform(low, high, (count, chain.dof))


def bent(name, compliance=0.15, half_play=0.0):
    model = load_model(name)
    n = model.chain.dof
    dynamics = Dynamics.from_masses(model.chain, link_masses(model, model.chain))
    return Bending(dynamics, np.full(n, compliance), np.full(n, half_play))


def bent_chain(name, compliance=0.15, half_play=0.0):
    return replace(
        load_model(name).chain, link_joints=bent(name, compliance, half_play).link_joints
    )


@pytest.mark.parametrize("name", ["so101", "koch", "open_manipulator_x"])
def test_computed_sagged_tip_equals_that_of_simulator(name):
    chain, model = bent_chain(name), load_model(name)
    yields = dict.fromkeys(chain.names, 0.15)
    world = make_arm_world(read_arm_file(model.path), specimen=Specimen(compliances=yields))
    for q in random_joints(chain, 10):
        positions = [0.0] * len(world.joints)
        for joint, value in zip(chain.names, q, strict=True):
            positions[[each.name for each in world.joints].index(joint)] = value
        drooped = chain.forward(q)[:3, 3]
        assert np.linalg.norm(drooped - chain.rigid.forward(q)[:3, 3]) > 1e-4
        np.testing.assert_allclose(drooped, world.tip.position_m(positions), atol=2e-4)


def test_batch_sagged_link_poses_equal_poses_of_each_posture():
    chain = bent_chain("so101", half_play=0.004)
    q = random_joints(chain, 6)
    poses = chain.link_poses(q)
    for i, one in enumerate(q):
        np.testing.assert_allclose(chain.forward(one), poses["gripper_frame"][i], atol=1e-9)
        np.testing.assert_allclose(chain.forward(one, "wrist"), poses["wrist"][i], atol=1e-9)


def test_sagged_links_are_in_static_equilibrium():
    bending = bent("so101", 0.15, 0.004)
    q = random_joints(bending.dynamics.chain, 20)
    links = bending.link_joints(q)
    np.testing.assert_allclose(links - bending.deflection(links), q, atol=1e-8)


def test_sag_derivatives_equal_finite_differences():
    bending = bent("so101", 0.1, 0.003)
    q, step = random_joints(bending.dynamics.chain, 5), 1e-5
    found = bending.derivatives(bending.link_joints(q))
    for k in range(bending.dynamics.chain.dof):
        by = step * np.eye(bending.dynamics.chain.dof)[k]
        pairs = (
            (bending.link_joints(q + by), bending.link_joints(q - by)),
            tuple(
                replace(bending, compliance=bending.compliance + way * by).link_joints(q)
                for way in (1, -1)
            ),
            tuple(
                replace(bending, half_play=bending.half_play + way * by).link_joints(q)
                for way in (1, -1)
            ),
        )
        for by_what, (after, before) in zip(found, pairs, strict=True):
            np.testing.assert_allclose(by_what[:, :, k], (after - before) / (2 * step), atol=2e-3)


def test_chain_without_compliance_is_its_own_rigid_chain():
    chain = load_model("so101").chain
    assert chain.rigid is chain
    assert bent_chain("so101").rigid.link_joints is None
