"""Pointing an axis of the tip at points, with the tip itself anywhere."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import ikservo
from ikservo.errors import BadValueError
from ikservo.ik.sight import solve_sight
from ikservo.model.tool import tool_frame

EXAMPLES = Path(__file__).parents[2] / "examples" / "arms"
PAN_TILT = EXAMPLES / "pan_tilt" / "arm.toml"
ARMS = [
    *("so101", "koch", "open_manipulator_x", "wx250s", "planar3"),
    *sorted(str(path) for path in EXAMPLES.glob("*/arm.toml") if path.parent.name != "gantry"),
]


def angle_off(chain, q, point_m, axis):
    """Compute the angle between the axis and the point, by the scalar product."""
    T = chain.forward(q)
    towards = np.asarray(point_m) - T[:3, 3]
    return math.acos(min(1.0, float(T[:3, :3] @ axis @ towards) / float(np.linalg.norm(towards))))


@pytest.mark.sample(3)
@pytest.mark.parametrize("arm", ARMS, ids=lambda arm: Path(arm).parent.name or arm)
def test_look_at_finds_posture_for_every_visible_point(arm):
    model = ikservo.load_model(arm)
    chain, axis, home = model.chain, tool_frame(model).approach_axis, model.chain_pose("home")
    rng = np.random.default_rng(3)
    for _ in range(25):
        T = chain.forward(rng.uniform(chain.lower_rad, chain.upper_rad))
        point_m = T[:3, 3] + rng.uniform(0.05, 3.0) * (T[:3, :3] @ axis)
        sight = solve_sight(chain, point_m, home, axis)
        assert sight.reached
        assert angle_off(chain, sight.q, point_m, axis) < 3e-4
        assert (chain.lower_rad <= sight.q).all()
        assert (sight.q <= chain.upper_rad).all()


def test_look_at_of_pan_tilt_gives_angles_towards_point():
    chain = ikservo.load_model(PAN_TILT).chain
    point_m = (1.0, 1.0, 0.095)  # at the height of the lens
    assert solve_sight(chain, point_m, [0.0, 0.0], (1, 0, 0)).q == pytest.approx(
        [math.pi / 4, 0.0], abs=1e-4
    )


def test_look_at_beyond_limits_reports_remaining_angle():
    chain = ikservo.load_model(PAN_TILT).chain
    sight = solve_sight(chain, (-1.0, 0.0, 0.095), [0.1, 0.0], (1, 0, 0))
    assert not sight.reached
    assert sight.error_rad == pytest.approx(math.pi - 2.8, abs=0.02)
    assert [str(limit) for limit in sight.binding] == ["pan at its upper limit"]


def test_look_at_of_point_on_tool_axis_keeps_joints():
    chain = ikservo.load_model(PAN_TILT).chain
    q = np.array([0.4, -0.3])
    T = chain.forward(q)
    assert solve_sight(chain, T[:3, 3] + 0.7 * T[:3, 0], q, (1, 0, 0)).q == pytest.approx(q)


@pytest.mark.parametrize("point_m", [(math.nan, 0, 0), (1, 0), (0, 0, 1e7)])
def test_look_at_refuses_invalid_point(point_m):
    chain = ikservo.load_model(PAN_TILT).chain
    with pytest.raises(BadValueError, match="The point to look at"):
        solve_sight(chain, point_m, [0.0, 0.0], (1, 0, 0))
