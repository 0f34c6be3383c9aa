"""Base frames of the catalogue: x forward, y left, z up, on the first axis at the surface."""

from __future__ import annotations

import numpy as np
import pytest

from ikservo.model import Model, arm_names, load_model
from ikservo.model.model_loading import build_chain

ARMS = arm_names()


def first_axis(model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Return a point (3,) [m] and the direction (3,) of the first joint's axis, base frame."""
    joint = next(j for j in model.urdf.joints if j.name == model.chain.names[0])
    to_joint = build_chain(model.urdf, joint.child)
    T = to_joint.forward(np.zeros(to_joint.dof))
    return T[:3, 3], T[:3, :3] @ joint.axis


@pytest.mark.parametrize("name", ARMS)
def test_base_frame_z_is_along_the_first_axis(name):
    np.testing.assert_allclose(np.abs(first_axis(load_model(name))[1]), [0, 0, 1], atol=1e-5)


@pytest.mark.parametrize("pose", ["home", "zero"])
@pytest.mark.parametrize("name", ARMS)
def test_base_frame_x_points_where_the_arm_points(name, pose):
    model = load_model(name)
    ahead, left = model.chain.forward(model.chain_pose(pose))[:2, 3] - first_axis(model)[0][:2]
    assert ahead > 0.1
    assert abs(left) < 0.01


@pytest.mark.parametrize("name", ARMS)
def test_base_frame_is_conventional_unless_arm_file_says_so(name):
    model = load_model(name)
    x_m, y_m, _ = first_axis(model)[0]
    conventional = max(abs(x_m), abs(y_m), abs(model.floor_m or 0.0)) < 1e-6
    assert conventional == (not model.base_frame)


@pytest.mark.parametrize("name", ARMS)
def test_base_frame_text_states_offset_of_model_origin(name):
    model = load_model(name)
    for offset_m in (first_axis(model)[0][0], model.floor_m or 0.0):
        if abs(offset_m) > 1e-6:
            assert f"{abs(offset_m) * 1e3:.4g} mm" in model.base_frame
