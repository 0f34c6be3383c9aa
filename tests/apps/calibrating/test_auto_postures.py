"""Before a joint is driven to its stop, the other joints move out of its path."""

import numpy as np
import pytest

from ikservo.apps.calibrating.auto_calibration_setup import PosturePlanner
from ikservo.errors import RefusedError
from ikservo.model.collision_capsules import collision_body
from tests.calibration.mounted_arms import load_model


@pytest.fixture(scope="module")
def so101():
    model = load_model("so101")
    return model, PosturePlanner(model)


def towards(so101, joint, end):
    model, postures = so101
    column = model.chain.names.index(joint)
    return postures.path_to_clear(column, 0.0, end, model.chain_pose("rest"))


def test_path_to_end_stop_search_posture_is_collision_free(so101):
    model, postures = so101
    way = towards(so101, "wrist_flex", 1.7)
    here = model.chain_pose("rest")
    for posture in way:
        postures.space.check_path(list(np.linspace(here, posture, 30)))
        here = posture


def test_end_stop_search_posture_keeps_tip_above_table(so101):
    model, _ = so101
    posture = towards(so101, "elbow_flex", -1.75)[-1]
    rows = np.tile(posture, (30, 1))
    rows[:, 2] = np.linspace(0.0, -1.75, 30)
    heights = model.chain.forward(rows)[:, 2, 3]
    assert (heights > 0.0).all()


def test_already_measured_joints_may_be_near_their_end_stops(so101):
    model = so101[0]
    postures = PosturePlanner(model)
    for joint in ("wrist_flex", "elbow_flex"):
        limits = model.joint(joint).limits
        column = model.chain.names.index(joint)
        postures.learn(column, limits.lower.value, limits.upper.value)
    posture = towards((model, postures), "shoulder_lift", 1.8)[-1]
    rows = np.tile(posture, (30, 1))
    rows[:, 1] = np.linspace(0.0, 1.8, 30)
    around = len(collision_body(model).pairs)
    assert postures.space.distances(rows)[:, around:].min() >= 0.0


def test_end_stop_below_table_is_refused_with_colliding_parts():
    model = load_model("wx250s")
    column = model.chain.names.index("shoulder")
    with pytest.raises(RefusedError, match=r"upper_arm would overlap the table by \d+ mm"):
        PosturePlanner(model).path_to_clear(column, 0.0, 2.0, model.chain_pose("rest"))
