"""Every shipped arm has the kinematics that Pinocchio computes from the same file."""

import numpy as np
import pinocchio
import pytest

from ikservo.model import load_model
from tests.oracle import ARMS, pinocchio_model

SAMPLES = 25


def sampled(name):
    """Yield our joints and Pinocchio's configuration for the same pose, inside the limits."""
    chain, model = load_model(name).chain, pinocchio_model(name)
    random = np.random.default_rng(7)
    for _ in range(SAMPLES):
        q = random.uniform(chain.lower_rad, chain.upper_rad)
        configuration = pinocchio.neutral(model)
        for joint, value in zip(chain.names, q, strict=True):
            configuration[model.joints[model.getJointId(joint)].idx_q] = value
        yield chain, model, q, configuration


@pytest.mark.parametrize("name", ARMS)
def test_tip_pose_equals_pinocchio(name):
    for chain, model, q, configuration in sampled(name):
        data = model.createData()
        pinocchio.framesForwardKinematics(model, data, configuration)
        expected = data.oMf[model.getFrameId(chain.tip)].homogeneous
        np.testing.assert_allclose(chain.forward(q), expected, atol=1e-12)


@pytest.mark.parametrize("name", ARMS)
def test_link_poses_equal_pinocchio(name):
    chain, model, q, configuration = next(sampled(name))
    data = model.createData()
    pinocchio.framesForwardKinematics(model, data, configuration)
    for frame in chain.frames:
        expected = data.oMf[model.getFrameId(frame, pinocchio.BODY)].homogeneous
        np.testing.assert_allclose(chain.forward(q, frame), expected, atol=1e-12)


@pytest.mark.parametrize("name", ARMS)
def test_jacobian_equals_pinocchio_in_world_axes(name):
    for chain, model, q, configuration in sampled(name):
        data = model.createData()
        tip = model.getFrameId(chain.tip)
        J = pinocchio.computeFrameJacobian(
            model, data, configuration, tip, pinocchio.LOCAL_WORLD_ALIGNED
        )
        columns = [model.joints[model.getJointId(joint)].idx_v for joint in chain.names]
        np.testing.assert_allclose(chain.jacobian(q), J[:, columns], atol=1e-12)


@pytest.mark.parametrize("name", ARMS)
def test_jacobian_of_point_beside_tip_is_central_difference(name):
    offset_m, h = (0.01, -0.02, 0.03), 1e-6
    chain, _, q, _ = next(sampled(name))
    J = chain.jacobian(q, offset_m=offset_m)
    for i in range(chain.dof):
        step = h * np.eye(chain.dof)[i]
        after, before = (chain.forward(q + s, offset_m=offset_m) for s in (step, -step))
        np.testing.assert_allclose(J[:3, i], (after - before)[:3, 3] / (2 * h), atol=1e-7)
