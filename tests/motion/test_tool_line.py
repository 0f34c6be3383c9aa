"""The tool goes straight, the joints keep their pace, and what cannot be done is said before."""

import math

import numpy as np
import pytest

from ikservo.errors import BadValueError, UnreachableError
from ikservo.model import load_model
from ikservo.motion import Pace, ToolLine

MODEL = load_model("so101")
CHAIN = MODEL.chain
HOME = MODEL.chain_pose("home")
PACES = [Pace(1.0, 3.0, 30.0)] * CHAIN.dof
FROM = CHAIN.forward(HOME)[:3, 3]


def line(dx=0.0, dy=0.1, dz=0.05, **kwargs):
    return ToolLine(CHAIN, HOME, FROM + np.array([dx, dy, dz]), PACES, **kwargs)


@pytest.mark.parametrize("step", [(0, 0.12, 0), (0.08, 0, 0.1), (-0.05, -0.1, 0.08), (0, 0, 0.15)])
def test_the_tip_strays_less_than_half_a_millimetre_from_the_line(step):
    motion = line(*step)
    along = np.array(step) / np.linalg.norm(step)
    for time_s in np.linspace(0, motion.duration_s, 150):
        gone = CHAIN.forward(motion.at(time_s))[:3, 3] - FROM
        assert np.linalg.norm(gone - (gone @ along) * along) < 5e-4


def test_it_ends_at_the_goal():
    motion = line()
    np.testing.assert_allclose(CHAIN.forward(motion.at(motion.duration_s))[:3, 3],
                               FROM + np.array([0, 0.1, 0.05]), atol=1e-5)  # fmt: skip


@pytest.mark.parametrize("speed_m_s", [0.02, 0.25, 5.0])
def test_no_joint_exceeds_its_pace_and_the_tip_not_its_speed(speed_m_s):
    motion = line(speed_m_s=speed_m_s)
    dt_s = motion.duration_s / 800
    states = [motion.state(i * dt_s) for i in range(801)]
    velocity, acceleration = (np.array([getattr(s, name) for s in states])
                              for name in ("velocity", "acceleration"))  # fmt: skip
    jerk = np.diff(acceleration, axis=0) / dt_s
    assert np.abs(velocity).max() <= 1.0
    assert np.abs(acceleration).max() <= 3.0
    assert np.abs(jerk).max() <= 30.0
    tips = np.array([CHAIN.forward(s.position)[:3, 3] for s in states])
    assert np.linalg.norm(np.diff(tips, axis=0), axis=1).max() / dt_s <= speed_m_s * 1.001


def test_the_velocity_is_the_derivative_of_the_position():
    motion, h = line(), 1e-5
    for time_s in np.linspace(0.1, motion.duration_s - 0.1, 20):
        slope = (motion.at(time_s + h) - motion.at(time_s - h)) / (2 * h)
        np.testing.assert_allclose(motion.state(time_s).velocity, slope, atol=1e-5)


def test_a_line_out_of_reach_is_refused_with_the_last_point_that_is_not():
    with pytest.raises(UnreachableError) as caught:
        line(dx=0.5)
    assert FROM[0] + 0.05 < caught.value.nearest_m[0] < FROM[0] + 0.3


def test_a_line_of_no_length_takes_no_time():
    assert line(0, 0, 0).duration_s == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("speed_m_s", [0.0, -1.0, math.nan, math.inf])
def test_a_speed_is_positive(speed_m_s):
    with pytest.raises(BadValueError, match="speed of the tool"):
        line(speed_m_s=speed_m_s)
