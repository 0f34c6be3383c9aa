"""Geometric errors of links, compared with finite differences and with results by hand."""

import numpy as np
import pytest

from ikservo.kinematics.geometric_errors import (
    GeometricErrors,
    apply_geometric_errors,
    calibration_jacobian,
    identifiable_origins,
)
from tests.calibration.mounted_arms import load_model
from tests.kinematics.chains import crane, planar
from tests.oracle import ARMS

STEP = 1e-6


def some_geometry(chain, seed=1):
    chance = np.random.default_rng(seed)
    origins = {name: chance.normal(0, 0.002, 3) for name in identifiable_origins(chain)}
    return GeometricErrors(chance.normal(0, 0.01, 3), chance.normal(0, 0.05, 3), origins)


def test_zero_geometric_corrections_leave_chain_unchanged():
    chain = load_model("so101").chain
    q = 0.1 * np.arange(chain.dof)
    np.testing.assert_array_equal(
        apply_geometric_errors(chain, GeometricErrors()).forward(q), chain.forward(q)
    )


def test_identifiable_joint_origins_exclude_first_joint():
    assert identifiable_origins(planar(0.3, 0.2, 0.1)) == ("j2", "j3", "end")
    assert identifiable_origins(planar(0.3)) == ("end",)
    assert identifiable_origins(crane()) == ("slide", "hook")


def test_base_rotation_correction_turns_every_link():
    chain, geometry = (
        load_model("so101").chain,
        GeometricErrors(base_rad=np.array([0.0, 0.0, np.pi / 2])),
    )
    q = chain.mid_range()
    x, y, z = chain.forward(q)[:3, 3]
    own = apply_geometric_errors(chain, geometry)
    np.testing.assert_allclose(own.forward(q)[:3, 3], (-y, x, z), atol=1e-12)
    links = own.link_poses(q)
    np.testing.assert_allclose(links[chain.tip], own.forward(q), atol=1e-12)


def test_tool_length_correction_moves_tip_outwards():
    chain = load_model("planar2").chain
    own = apply_geometric_errors(
        chain, GeometricErrors(origins_m={"tool_joint": np.array([0.01, 0.0, 0.0])})
    )
    reach = [c.forward([0.0, 0.0])[0, 3] for c in (chain, own)]
    assert reach[1] - reach[0] == pytest.approx(0.01)


@pytest.mark.parametrize("name", ARMS)
def test_geometry_jacobian_equals_finite_differences(name):
    chain = load_model(name).chain
    names, base = identifiable_origins(chain), some_geometry(chain)
    q = np.random.default_rng(2).uniform(-0.5, 0.5, (3, chain.dof))

    def tips(x):
        moves = x[chain.dof + 6 :].reshape(-1, 3)
        geometry = GeometricErrors(
            base.base_m + x[chain.dof : chain.dof + 3],
            base.base_rad + x[chain.dof + 3 : chain.dof + 6],
            {n: base.origins_m[n] + m for n, m in zip(names, moves, strict=True)},
        )
        return apply_geometric_errors(chain, geometry).forward(q + x[: chain.dof])[:, :3, 3]

    found, J = calibration_jacobian(chain, q, base, names)
    zero = np.zeros(J.shape[2])
    np.testing.assert_allclose(found, tips(zero), atol=1e-12)
    for k in range(J.shape[2]):
        up = np.eye(len(zero))[k] * STEP
        np.testing.assert_allclose(J[:, :, k], (tips(up) - tips(-up)) / (2 * STEP), atol=2e-6)
