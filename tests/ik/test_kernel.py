"""The kernels' arithmetic against the chain's and against finite differences."""

import os

import numpy as np
import pytest

from ikservo.ik.kernel import forward_kinematics as looking
from ikservo.ik.kernel import forward_kinematics as placing
from ikservo.ik.kernel import layout
from ikservo.ik.kernel import linear_algebra as bending
from ikservo.ik.kernel.forward_kinematics import sincos
from ikservo.ik.kernel.jit import remove_stale_caches
from ikservo.ik.kernel.layout import HESSIAN, NEG_GRAD, TOOL_POSE, J, Q, work_shape
from ikservo.kinematics import pack_chain
from ikservo.kinematics.se3 import exp_so3
from ikservo.model import load_model
from tests.kinematics.chains import crane

QUESTION = np.concatenate([[0.2, -0.1, 0.15], exp_so3([0.4, -1.1, 0.7]).ravel()])


@pytest.fixture(autouse=True)
def interpreted(monkeypatch):
    """Run the kernels' source as Python: to compile parts of it on their own takes seconds."""
    for module in (bending, looking, placing):
        for name, function in list(vars(module).items()):
            monkeypatch.setattr(module, name, getattr(function, "py_func", function))


def desk_for(chain, q):
    desk = np.zeros(work_shape(chain.dof, 1))
    desk[Q, : chain.dof] = q
    return desk


@pytest.mark.parametrize("frame", ["gripper_frame", "forearm"])
def test_the_packed_arm_is_placed_where_the_chain_is(frame):
    chain, q, offset = (
        load_model("so101").chain,
        np.array([0.3, -0.5, 0.7, 0.2, 1.0]),
        (0.01, 0.02, 0.03),
    )
    desk = desk_for(chain, q)
    placing.forward_kinematics(pack_chain(chain, frame, np.array(offset)), desk)
    T, jacobian = chain.forward_and_jacobian(q, frame, offset)
    np.testing.assert_allclose(desk[TOOL_POSE, :9].reshape(3, 3), T[:3, :3], atol=1e-14)
    np.testing.assert_allclose(desk[TOOL_POSE, 9:12], T[:3, 3], atol=1e-14)
    np.testing.assert_allclose(desk[J : J + 6, : chain.dof], jacobian, atol=1e-14)


def test_slides_and_mimics_are_placed_where_the_chain_puts_them():
    chain, q = crane(), np.array([0.7, 0.2])
    desk = desk_for(chain, q)
    placing.forward_kinematics(pack_chain(chain), desk)
    T, jacobian = chain.forward_and_jacobian(q)
    np.testing.assert_allclose(desk[TOOL_POSE, 9:12], T[:3, 3], atol=1e-15)
    np.testing.assert_allclose(desk[J : J + 6, :2], jacobian, atol=1e-15)


@pytest.mark.parametrize("kind", [layout.POSITION_ONLY, layout.DIRECTION, layout.POSE])
def test_the_second_derivative_is_the_difference_of_gradients(kind):
    chain, q, h = load_model("wx250s").chain, np.array([0.3, -0.5, 0.7, 0.2, 1.0, -0.4]), 1e-6
    arm, n = pack_chain(chain), chain.dof

    def pull(joints):
        desk = desk_for(chain, joints)
        looking.evaluate(arm, QUESTION, kind, 0.2, desk)
        return desk[NEG_GRAD, :n].copy()

    desk = desk_for(chain, q)
    looking.evaluate(arm, QUESTION, kind, 0.2, desk)
    bending.hessian(QUESTION, kind, 0.2, n, desk)
    upper = np.triu(desk[HESSIAN : HESSIAN + n, :n])
    differences = [(pull(q - h * e) - pull(q + h * e)) / (2 * h) for e in np.eye(n)]
    np.testing.assert_allclose(upper, np.triu(differences), atol=1e-8)


def test_cosine_and_sine_are_right_to_the_last_digits():
    interpreted = getattr(sincos, "py_func", sincos)
    angles = [scale * part for scale in (1.0, 100.0, 1e6) for part in np.linspace(-1, 1, 301)]
    found = np.array([interpreted(angle) for angle in angles])
    np.testing.assert_allclose(found, np.array([np.cos(angles), np.sin(angles)]).T, atol=4e-16)


def test_kernels_that_older_versions_left_behind_are_removed(tmp_path):
    for name, made_s in [("kernels-old", 1_000.0), ("kernels-new", 3_000.0), ("mine", 1_000.0)]:
        (tmp_path / name / "part").mkdir(parents=True)
        os.utime(tmp_path / name, (made_s, made_s))
    remove_stale_caches(tmp_path, before_s=2_000.0)
    assert sorted(folder.name for folder in tmp_path.iterdir()) == ["kernels-new", "mine"]


def test_a_cache_that_does_not_exist_yet_has_nothing_stale(tmp_path):
    remove_stale_caches(tmp_path / "nowhere", before_s=2_000.0)
