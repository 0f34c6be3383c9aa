"""Requests of ROS 2 as setpoints; unusable ones are refused with a reason."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from ikservo.apps.remote.ros.goals import TwistGoal, check_age, pose_goal, trajectory_goal
from ikservo.apps.remote.ros.wire import Attachment, NodeName, data_key, endpoint_token, node_token
from ikservo.apps.remote.ros.wire import EndpointKind as Kind
from ikservo.errors import IkservoError
from ikservo.ros_messages.message_types import TRIGGER, make, type_hash

PRESENT, LIMITS = {"a": 0.0, "b": 0.1}, {"a": (-1.0, 1.0), "b": (-2.0, 2.0)}
NODE = NodeName(5, "1ce1ee", "", "arm")
SAMPLE = bytes.fromhex("0900000000000000df8ab6f7e735d31810fe98e4a3b54b6e599c5934f4cfc25343")


def stamp(seconds):
    return make("builtin_interfaces/msg/Duration", sec=math.floor(seconds),
                nanosec=round(seconds % 1 * 1e9))  # fmt: skip


def trajectory(names, *points, velocities=None):
    """Return a message; points are a time [s] and positions."""
    speeds = velocities or [()] * len(points)
    return SimpleNamespace(
        joint_names=names,
        points=[
            SimpleNamespace(positions=positions, velocities=v, time_from_start=stamp(time_s))
            for (time_s, positions), v in zip(points, speeds, strict=True)
        ],
    )


def goal(message):
    return trajectory_goal(message, PRESENT, LIMITS, 100.0)


def test_ros_message_attachment_matches_rmw_zenoh_sample():
    read = Attachment.from_bytes(SAMPLE)
    assert (read.sequence, read.gid.hex()) == (9, "fe98e4a3b54b6e599c5934f4cfc25343")
    assert read.to_bytes() == SAMPLE
    for wrong in (b"", SAMPLE[:-1], SAMPLE + b"\0", SAMPLE[:16] + b"\x11" + SAMPLE[17:]):
        with pytest.raises(IkservoError, match="attachment"):
            Attachment.from_bytes(wrong)


def test_ros_keys_and_tokens_match_rmw_zenoh_design():
    hashed = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
    string = "std_msgs/msg/String"
    assert data_key(NODE, "/chatter", string) == f"5/chatter/std_msgs::msg::dds_::String_/{hashed}"
    assert node_token(NODE) == "@ros2_lv/5/1ce1ee/0/0/NN/%/%/arm"
    left = NodeName(5, "1ce1ee", "/left", "arm")
    assert endpoint_token(left, 3, Kind.PUBLISHER, "/chatter", string, latched=False) == (
        "@ros2_lv/5/1ce1ee/0/3/MP/%/%left/arm/%left%chatter/std_msgs::msg::dds_::String_/"
        f"{hashed}/::,10:,:,:,,"
    )


def test_trigger_service_hash_matches_ros_2():
    hashed = "RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f"
    assert type_hash(TRIGGER) == hashed


def test_ros_trajectory_starts_at_joints_and_is_linear():
    asked = goal(trajectory(["b", "a"], (1.0, [0.5, 1.0]), (3.0, [0.5, 0.0])))
    found = [asked.setpoint(100.0 + t, None) for t in (0.0, 0.5, 1.0, 2.0, 3.0, 9.0)]
    np.testing.assert_allclose([each["a"] for each in found], [0.0, 0.5, 1.0, 0.5, 0.0, 0.0])
    np.testing.assert_allclose([each["b"] for each in found], [0.1, 0.3, 0.5, 0.5, 0.5, 0.5])
    assert [asked.has_ended(100.0 + t) for t in (2.9, 3.0)] == [False, True]


def test_velocities_of_ros_trajectory_points_are_kept():
    asked = goal(trajectory(["a"], (0.0, [0.0]), (2.0, [0.4]), velocities=[(0.3,), (-0.1,)]))
    at = lambda t: asked.setpoint(100.0 + t, None)["a"]  # noqa: E731
    assert (at(1e-4) - at(0.0)) / 1e-4 == pytest.approx(0.3, abs=1e-3)
    assert (at(2.0) - at(2.0 - 1e-4)) / 1e-4 == pytest.approx(-0.1, abs=1e-3)
    assert at(2.0) == pytest.approx(0.4)


@pytest.mark.parametrize(
    ("message", "found"),
    [
        (trajectory(["elbow"], (1.0, [0.0])), "elbow"),
        (trajectory([], (1.0, [])), "each once"),
        (trajectory(["a", "a"], (1.0, [0.0, 0.0])), "each once"),
        (trajectory(["a"], (1.0, [0.0, 1.0])), "point 1"),
        (trajectory(["a"], (1.0, [0.0]), (2.0, [math.nan])), "point 2"),
        (trajectory(["a"], (1.0, [0.0]), (1.0, [0.1])), "not increasing"),
        (trajectory(["a"], (-1.0, [0.0])), "not increasing"),
        (trajectory(["a"], (1e6, [0.0])), "not increasing"),
        (trajectory(["a"], (1.0, [0.0]), (2.0, [1.2])), "a at point 2 is 1.200, outside"),
        (trajectory(["a"], *[(0.1 * k, [0.0]) for k in range(10_001)]), "10001 points"),
    ],
)
def test_unusable_ros_trajectory_is_refused_with_reason(message, found):
    with pytest.raises(IkservoError, match=found):
        goal(message)


@pytest.mark.parametrize(("age_s", "found"), [(0.5, "old"), (-5.0, "in the future")])
def test_ros_message_with_old_or_future_time_is_refused(age_s, found):
    check_age(stamp(1000.0), 1000.2)
    check_age(stamp(0.0), 1000.0)
    with pytest.raises(IkservoError, match=found):
        check_age(stamp(1000.0), 1000.0 + age_s)


def test_ros_twist_target_stays_near_tip_and_stops_if_silent():
    twist, tip_m = TwistGoal(np.eye(4), 0.0), np.zeros(3)
    twist.update(np.array([0.1, 0.0, 0.0]), np.zeros(3), of_tool=False, now_s=0.0)
    np.testing.assert_allclose(twist.setpoint(0.1, tip_m).position, [0.01, 0.0, 0.0])
    for k in range(2, 30):
        twist.update(np.array([0.1, 0.0, 0.0]), np.zeros(3), of_tool=False, now_s=0.1 * k)
        reached = twist.setpoint(0.1 * k, tip_m).position[0]
    assert 0.05 < reached <= 0.03 + 0.3 * 0.1
    silent = [twist.setpoint(2.9 + t, np.array([0.05, 0, 0])).position[0] for t in (0.3, 5.0)]
    assert silent == pytest.approx([silent[0]] * 2)
    assert silent[0] <= reached + 0.031
    assert [twist.has_ended(2.9 + t) for t in (0.29, 0.31)] == [False, True]


def test_ros_twist_in_tool_frame_is_rotated_to_base_frame():
    T = np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    twist = TwistGoal(T, 0.0)
    twist.update(np.array([0.1, 0, 0]), np.array([0, 0, 1.0]), of_tool=True, now_s=0.0)
    pose = twist.setpoint(0.1, np.zeros(3))
    np.testing.assert_allclose(pose[:3, 3], [0.0, 0.01, 0.0], atol=1e-12)
    np.testing.assert_allclose(pose[:2, 0], [-math.sin(0.1), math.cos(0.1)], atol=1e-12)


@pytest.mark.parametrize(
    ("linear", "angular"),
    [((0.6, 0, 0), (0, 0, 0)), ((0, 0, 0), (4.0, 0, 0)), ((np.nan, 0, 0), (0, 0, 0))],
)
def test_too_fast_or_nan_ros_twist_is_refused(linear, angular):
    twist = TwistGoal(np.eye(4), 0.0)
    with pytest.raises(IkservoError, match="velocity"):
        twist.update(np.array(linear), np.array(angular), of_tool=False, now_s=0.0)


def pose(*q, x=0.2):
    point = SimpleNamespace(x=x, y=0.0, z=0.1)
    return SimpleNamespace(
        position=point, orientation=SimpleNamespace(**dict(zip("xyzw", q, strict=True)))
    )


def test_ros_pose_with_zero_quaternion_frees_orientation():
    assert pose_goal(pose(0, 0, 0, 0)).setpoint(0.0, None).only_position
    half = math.sqrt(0.5)
    T = pose_goal(pose(0, 0, half, half)).setpoint(0.0, None)
    np.testing.assert_allclose(T[:3, :3] @ [1, 0, 0], [0, 1, 0], atol=1e-12)


@pytest.mark.parametrize("wrong", [pose(0, 0, 0, 0.3), pose(0, 0, 0, 1, x=np.inf)])
def test_invalid_ros_pose_is_refused(wrong):
    with pytest.raises(IkservoError):
        pose_goal(wrong)
