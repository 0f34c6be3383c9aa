"""Collision checks include the jaws at their present opening, in every motion of the arm."""

from dataclasses import replace

import coal
import numpy as np
import pinocchio
import pytest

import ikservo
from ikservo.errors import RefusedError
from ikservo.guard import CollisionChecker
from ikservo.model import load_model
from ikservo.model.arm_model import KeepOutBox
from ikservo.model.collision_capsules import collision_body_with_gripper
from tests.arm.simulated import clock_of, true_joints
from tests.oracle import CONFIGS

GRIPPERS = ("so101", "so100", "koch", "omx_f", "open_manipulator_x", "px100", "px150", "rx150",
            "rx200", "wx200", "wx250s", "vx250", "vx300s")  # fmt: skip
DEEP_M = -2.0  # a floor that no arm comes near


def between(gripper, share):
    """Return the jaws' position at a fraction of their travel from closed to open."""
    return gripper.closed + share * (gripper.open - gripper.closed)


class Exact:
    """The shapes of an arm's URDF, its jaws included, as Coal sees them."""

    def __init__(self, name):
        urdf = str(CONFIGS / name / "arm.urdf")
        self._model = pinocchio.buildModelFromUrdf(urdf)
        self._shapes = pinocchio.buildGeomFromUrdf(self._model, urdf, pinocchio.COLLISION)
        self._data, self._placed = self._model.createData(), self._shapes.createData()
        self._mimics = {j.name: j.mimic for j in load_model(name).urdf.joints if j.mimic}

    def above_floor_m(self, joints):
        """Return the height of each link above a deep floor, by link."""
        q = pinocchio.neutral(self._model)
        mirrored = {name: mimic.multiplier * joints[mimic.joint] + mimic.offset
                    for name, mimic in self._mimics.items() if mimic.joint in joints}  # fmt: skip
        for joint, value in (joints | mirrored).items():
            q[self._model.joints[self._model.getJointId(joint)].idx_q] = value
        pinocchio.updateGeometryPlacements(self._model, self._data, self._shapes, self._placed, q)
        found = {}
        for shape, place in zip(self._shapes.geometryObjects, self._placed.oMg, strict=True):
            link = self._model.frames[shape.parentFrame].name
            found[link] = min(found.get(link, np.inf), _height_m(shape.geometry, place))
        return found


def _height_m(shape, place):
    floor = coal.Halfspace(np.array([0.0, 0.0, 1.0]), DEEP_M)
    at = coal.Transform3s(place.rotation, place.translation)
    result = coal.DistanceResult()
    return coal.distance(shape, at, floor, coal.Transform3s(), coal.DistanceRequest(), result)


@pytest.mark.parametrize("name", GRIPPERS)
def test_collision_capsules_cover_jaws_at_every_opening(name):
    model, exact = load_model(name), Exact(name)
    space, random = (
        CollisionChecker(collision_body_with_gripper(model), DEEP_M),
        np.random.default_rng(17),
    )
    lower, upper = (
        side.clip(-np.pi, np.pi) for side in (model.chain.lower_rad, model.chain.upper_rad)
    )
    jaws = {j.child for j in model.urdf.joints
            if model.gripper.joint in (j.name, j.mimic and j.mimic.joint)}  # fmt: skip
    columns = {link: i for i, (link, thing) in enumerate(space.pairs) if thing == "the table"}
    for share in np.linspace(0.0, 1.0, 60):
        q = random.uniform(lower, upper)
        at = between(model.gripper, share)
        truth = exact.above_floor_m(dict(zip(model.chain.names, q, strict=True))
                                    | {model.gripper.joint: at})  # fmt: skip
        gap_m = space.distances([np.append(q, at)])[0]
        for jaw in jaws:
            assert -0.015 < gap_m[columns[jaw]] - truth[jaw] <= 1e-6


@pytest.mark.parametrize("name", GRIPPERS)
def test_jaws_can_open_and_close_in_every_named_pose(name):
    model = load_model(name)
    space = CollisionChecker(collision_body_with_gripper(model), model.floor_m)
    for pose in model.poses:
        q = model.chain_pose(pose)
        ways = [np.append(q, between(model.gripper, share)) for share in np.linspace(0, 1, 30)]
        space.check_path(ways)
        space.check_path(ways[::-1])


# In the pose home an open jaw of an SO-101 would be in it; a closed one is 6 cm away.
LAMP = KeepOutBox("the lamp", (0.26, -0.02, 0.185), (0.29, 0.01, 0.215))


@pytest.fixture
def arm():
    model = replace(load_model("so101"), keep_out=(LAMP,))
    with ikservo.open_arm(model, port="sim:?pose=home") as machine:
        machine.pose("home", speed="fast")  # a limp arm sinks until its torque is on
        yield machine


@pytest.mark.full
def test_gripper_refuses_to_open_jaws_against_an_obstacle(arm):
    before = true_joints(arm)
    with pytest.raises(RefusedError, match="jaw would touch the lamp"):
        arm.gripper("open")
    assert true_joints(arm)["gripper"] == pytest.approx(before["gripper"], abs=0.01)
    assert arm.gripper("close").reached


@pytest.mark.campaign
def test_jaws_open_after_arm_has_moved_away_from_obstacle(arm):
    arm.move_joints({"shoulder_pan": -0.5}, speed="fast")
    assert arm.gripper("open").reached


@pytest.mark.full
def test_path_free_with_closed_jaws_is_refused_with_open_jaws(arm):
    arm.gripper("close")
    assert arm.move_joints({"shoulder_pan": -0.5}, speed="fast").reached
    assert arm.move_joints({"shoulder_pan": 0.0}, speed="fast").reached
    arm.move_joints({"shoulder_pan": -0.5}, speed="fast")
    arm.gripper("open")
    with pytest.raises(RefusedError, match="jaw would touch the lamp"):
        arm.move_joints({"shoulder_pan": 0.0})
    assert true_joints(arm)["shoulder_pan"] == pytest.approx(-0.5, abs=0.01)


@pytest.mark.full
def test_follow_does_not_carry_open_jaws_into_obstacle(arm):
    arm.move_joints({"shoulder_pan": -0.5}, speed="fast")
    arm.gripper("open")
    report = arm.follow([{"shoulder_pan": 0.0}] * 20)
    assert "jaw would touch the lamp" in report.reason
    assert true_joints(arm)["shoulder_pan"] == pytest.approx(-0.5, abs=0.01)


@pytest.mark.full
def test_jaws_open_at_obstacle_without_collision_checks():
    model = replace(load_model("so101"), keep_out=(LAMP,))
    with ikservo.open_arm(model, port="sim:?pose=home", collisions=False) as arm:
        assert arm.gripper("open").reached


@pytest.mark.full
@pytest.mark.sample(1)
@pytest.mark.parametrize("name", ["omx_f", "koch"])
def test_jaws_open_and_close_after_limp_arm_has_sagged(name):
    with ikservo.open_arm(name, port="sim") as arm:
        clock_of(arm).sleep_until(clock_of(arm).now_s() + 5.0)
        assert arm.gripper("open").reached
        assert arm.gripper("close").reached
