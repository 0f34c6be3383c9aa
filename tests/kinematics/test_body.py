"""The body of an arm: what comes near what, and what is no pair at all."""

import numpy as np

from ikservo.kinematics.body import Body
from ikservo.kinematics.capsules import Capsule
from tests.kinematics.chains import planar


def test_an_arm_whose_links_are_all_joined_has_no_pairs_that_could_meet():
    ends = np.zeros(3), np.array([0.3, 0.0, 0.0])
    body = Body(planar(0.3, 0.2), [Capsule(link, *ends, 0.02) for link in ("l0", "l1")])
    gaps = body.between_links(np.zeros((3, 2)))
    assert (gaps.pairs, gaps.gap_m.shape) == ((), (3, 0))
