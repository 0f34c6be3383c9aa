"""Joint torques of a force at the tip."""

import math

import numpy as np
import pytest

from ikservo.errors import BadValueError
from ikservo.kinematics import joint_torques
from ikservo.model import load_model
from tests.kinematics.chains import crane, planar


def test_transverse_force_on_stretched_links_gives_lever_torques():
    tau = joint_torques(planar(0.3, 0.2), [0.0, 0.0], (0.0, 10.0, 0.0))
    np.testing.assert_allclose(tau, [5.0, 2.0])


def test_force_along_stretched_links_does_not_give_torque():
    tau = joint_torques(planar(0.3, 0.2), [0.6, 0.0], (math.cos(0.6), math.sin(0.6), 0.0))
    np.testing.assert_allclose(tau, 0.0, atol=1e-15)


def test_joint_torques_do_same_virtual_work_as_force():
    model = load_model("so101")
    chain, rng = model.chain, np.random.default_rng(5)
    for _ in range(20):
        q, force = rng.uniform(chain.lower_rad, chain.upper_rad), rng.normal(size=3)
        dq = 1e-7 * rng.normal(size=chain.dof)
        moved = chain.forward(q + dq)[:3, 3] - chain.forward(q - dq)[:3, 3]
        work = 2.0 * dq @ joint_torques(chain, q, force)
        assert work == pytest.approx(float(force @ moved), rel=1e-6, abs=1e-14)


def test_moment_load_gives_joint_torques_by_their_axes():
    tau = joint_torques(planar(0.3, 0.2), [0.2, 0.4], (0, 0, 0), moment_nm=(3.0, 4.0, 0.5))
    np.testing.assert_allclose(tau, [0.5, 0.5])


def test_prismatic_joint_force_includes_share_of_its_mimic():
    tau = joint_torques(crane(), [0.0, 0.2], (2.0, 0.0, -8.0))
    assert tau[1] == pytest.approx(2.0 + 0.5 * 8.0)


def test_force_on_inner_link_does_not_load_joints_beyond_it():
    tau = joint_torques(planar(0.3, 0.2), [0.2, 0.4], (0, 1, 0), frame="l1", offset_m=(0.1, 0, 0))
    assert tau[0] == pytest.approx(0.1 * math.cos(0.2))
    assert tau[1] == 0.0


@pytest.mark.parametrize("force", [(0, 0), (0, 0, math.inf), ("1", "2", "3"), None])
def test_invalid_tip_force_is_refused(force):
    with pytest.raises(BadValueError):
        joint_torques(planar(0.3, 0.2), [0.0, 0.0], force)
