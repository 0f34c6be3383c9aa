"""The kernels' arithmetic, compared with the chain's and with finite differences."""

import numpy as np
import pytest

from ikservo.kernels import forward_kinematics, layout, linear_algebra
from ikservo.kernels.forward_kinematics import sincos
from ikservo.kernels.layout import HESSIAN, NEG_GRAD, TOOL_POSE, J, Q, work_shape
from ikservo.kinematics import pack_chain
from ikservo.kinematics.se3 import exp_so3
from ikservo.model import load_model
from tests.kinematics.chains import crane

PROBLEM = np.concatenate([[0.2, -0.1, 0.15], exp_so3([0.4, -1.1, 0.7]).ravel()])


def work_for(chain, q):
    work = np.zeros(work_shape(chain.dof, 1))
    work[Q, : chain.dof] = q
    return work


@pytest.mark.parametrize("frame", ["gripper_frame", "forearm"])
def test_packed_arm_pose_and_jacobian_equal_those_of_chain(frame):
    chain, q, offset = (
        load_model("so101").chain,
        np.array([0.3, -0.5, 0.7, 0.2, 1.0]),
        (0.01, 0.02, 0.03),
    )
    work = work_for(chain, q)
    forward_kinematics.forward_kinematics(pack_chain(chain, frame, np.array(offset)), work)
    T, jacobian = chain.forward_and_jacobian(q, frame, offset)
    np.testing.assert_allclose(work[TOOL_POSE, :9].reshape(3, 3), T[:3, :3], atol=1e-14)
    np.testing.assert_allclose(work[TOOL_POSE, 9:12], T[:3, 3], atol=1e-14)
    np.testing.assert_allclose(work[J : J + 6, : chain.dof], jacobian, atol=1e-14)


def test_packed_prismatic_and_mimic_joints_equal_chain():
    chain, q = crane(), np.array([0.7, 0.2])
    work = work_for(chain, q)
    forward_kinematics.forward_kinematics(pack_chain(chain), work)
    T, jacobian = chain.forward_and_jacobian(q)
    np.testing.assert_allclose(work[TOOL_POSE, 9:12], T[:3, 3], atol=1e-15)
    np.testing.assert_allclose(work[J : J + 6, :2], jacobian, atol=1e-15)


@pytest.mark.parametrize("kind", [layout.POSITION_ONLY, layout.DIRECTION, layout.POSE])
def test_hessian_equals_finite_difference_of_gradients(kind):
    chain, q, h = load_model("wx250s").chain, np.array([0.3, -0.5, 0.7, 0.2, 1.0, -0.4]), 1e-6
    arm, n = pack_chain(chain), chain.dof

    def pull(joints):
        work = work_for(chain, joints)
        forward_kinematics.evaluate(arm, PROBLEM, kind, 0.2, work)
        return work[NEG_GRAD, :n].copy()

    work = work_for(chain, q)
    forward_kinematics.evaluate(arm, PROBLEM, kind, 0.2, work)
    linear_algebra.hessian(PROBLEM, kind, 0.2, n, work)
    upper = np.triu(work[HESSIAN : HESSIAN + n, :n])
    differences = [(pull(q - h * e) - pull(q + h * e)) / (2 * h) for e in np.eye(n)]
    np.testing.assert_allclose(upper, np.triu(differences), atol=1e-8)


def test_kernel_sincos_is_exact_to_4e_16():
    angles = [scale * part for scale in (1.0, 100.0, 1e6) for part in np.linspace(-1, 1, 301)]
    found = np.array([sincos(angle) for angle in angles])
    np.testing.assert_allclose(found, np.array([np.cos(angles), np.sin(angles)]).T, atol=4e-16)
