"""Other ROS 2 implementations see the arm in the graph, read it and move its servos."""

import contextlib
import json
import signal
import struct
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
import zenoh
import zenoh.ext
import zenoh_ros2_sdk
from ros2_pyterfaces.cyclone.diagnostic_msgs.msg import DiagnosticArray
from ros2_pyterfaces.cyclone.geometry_msgs.msg import PoseStamped, TwistStamped
from ros2_pyterfaces.cyclone.sensor_msgs.msg import JointState
from ros2_pyterfaces.cyclone.std_msgs.msg import String
from ros2_pyterfaces.cyclone.std_srvs.srv import Trigger
from ros2_pyterfaces.cyclone.trajectory_msgs.msg import JointTrajectory
from rosbags.typesys import get_types_from_msg
from zenoh_ros2_sdk import discovery
from zenoh_ros2_sdk.session import ZenohSession

from ikservo.apps.remote.address import Endpoint
from ikservo.apps.remote.ros.bridge import RosBridge
from ikservo.apps.remote.ros.trajectory_action import ACTION
from ikservo.apps.remote.zenoh_session import open_router_client
from ikservo.cli import main
from tests.apps.remote.conftest import TIMEOUT_S, find_free_port, serve, until
from tests.apps.remote.ros_graph import HOST, Graph, bridged, router, trajectory
from tests.arm.simulated import true_joints, true_tip_m

CONSOLE = "import sys; from ikservo.cli.entry_point import console; console()"
DEFINITIONS = {  # which the SDK would fetch from GitHub
    "builtin_interfaces/msg/Time": "int32 sec\nuint32 nanosec",
    "std_msgs/msg/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "sensor_msgs/msg/JointState": "std_msgs/Header header\nstring[] name\nfloat64[] position\n"
    "float64[] velocity\nfloat64[] effort",
}


@pytest.fixture
def sdk(graph):
    """A session of ROBOTIS's SDK, with the messages that it can read."""
    session = ZenohSession.get_instance(HOST, graph.port)
    for name, text in DEFINITIONS.items():
        session.store.register(get_types_from_msg(text, name))
        session._registered_types[name] = name
    yield {"router_ip": HOST, "router_port": graph.port, "domain_id": 0}
    session.close()


@pytest.mark.full
def test_independent_ros_client_can_use_every_bridge_topic(graph, sdk):
    assert dict(discovery.get_topic_names_and_types(0, HOST, graph.port)) == {
        "/joint_states": ["sensor_msgs/msg/JointState"], "/tf": ["tf2_msgs/msg/TFMessage"],
        "/robot_description": ["std_msgs/msg/String"],
        "/diagnostics": ["diagnostic_msgs/msg/DiagnosticArray"],
        "/joint_trajectory": ["trajectory_msgs/msg/JointTrajectory"],
        "/servo_twist": ["geometry_msgs/msg/TwistStamped"],
        "/target_pose": ["geometry_msgs/msg/PoseStamped"],
        f"{ACTION}/_action/feedback": ["control_msgs/action/FollowJointTrajectory_FeedbackMessage"],
        f"{ACTION}/_action/status": ["action_msgs/msg/GoalStatusArray"],
    }  # fmt: skip
    services = dict(discovery.get_service_names_and_types(0, HOST, graph.port))
    triggers = {name: ["std_srvs/srv/Trigger"] for name in ("/stop", "/hold", "/acknowledge")}
    assert services == triggers | {
        f"{ACTION}/_action/send_goal": ["control_msgs/action/FollowJointTrajectory_SendGoal"],
        f"{ACTION}/_action/get_result": ["control_msgs/action/FollowJointTrajectory_GetResult"],
        f"{ACTION}/_action/cancel_goal": ["action_msgs/srv/CancelGoal"],
    }
    info = discovery.get_topic_info("/joint_states", 0, HOST, graph.port, verbose=True)
    assert [(each.node_name, each.type_hash) for each in info.publishers] == [
        ("ikservo_so101", JointState.hash_rihs01())
    ]
    seen = []
    subscriber = zenoh_ros2_sdk.ROS2Subscriber(
        "/joint_states", "sensor_msgs/msg/JointState", seen.append,
        type_hash=JointState.hash_rihs01(), **sdk,
    )  # fmt: skip
    client = zenoh_ros2_sdk.ROS2ServiceClient(
        "/hold", "std_srvs/srv/Trigger", request_definition="",
        response_definition="bool success\nstring message", type_hash=Trigger.hash_rihs01(), **sdk,
    )  # fmt: skip
    assert client.call().success
    until(lambda: seen)
    subscriber.close()
    client.close()
    assert tuple(seen[-1].name) == graph.arm.joint_names


def test_ros_joint_states_match_simulated_servos(graph):
    message, sample = graph.next("/joint_states", JointState)
    truth = true_joints(graph.arm)
    assert dict(zip(message.name, message.position, strict=True)) == pytest.approx(truth, abs=0.003)
    assert abs(message.header.stamp.sec - time.time()) < 5
    _, sent_ns, length, _ = struct.unpack("<qqB16s", sample.attachment.to_bytes())
    assert (length, abs(sent_ns - time.time_ns()) < 5e9) == (16, True)


@pytest.mark.full
def test_ros_trajectory_moves_servos_along_its_points(graph):
    start = true_joints(graph.arm)["wrist_roll"]
    graph.publish("/joint_trajectory", trajectory("wrist_roll", (1.0, start + 0.3), (2.5, start)))
    seen = []

    def passed():
        seen.append(true_joints(graph.arm)["wrist_roll"])
        return max(seen) > start + 0.15

    until(passed)
    graph.wait_until_still()
    assert true_joints(graph.arm)["wrist_roll"] == pytest.approx(start, abs=0.02)
    assert graph.warnings == []


@pytest.mark.campaign
def test_empty_ros_trajectory_ends_current_motion(graph):
    start = true_joints(graph.arm)["wrist_roll"]
    graph.publish("/joint_trajectory", trajectory("wrist_roll", (20.0, start + 1.0)))
    until(lambda: true_joints(graph.arm)["wrist_roll"] > start + 0.05)
    graph.publish("/joint_trajectory", JointTrajectory())
    graph.wait_until_still()
    assert true_joints(graph.arm)["wrist_roll"] < start + 0.6
    assert graph.arm.stop_reason is None


@pytest.mark.full
def test_ros_target_pose_is_reached(graph):
    pose = PoseStamped()
    pose.header.frame_id = "base"
    pose.pose.position.x, pose.pose.position.y, pose.pose.position.z = 0.22, 0.03, 0.12
    pose.pose.orientation.w = 0.0
    graph.publish("/target_pose", pose)
    until(lambda: np.allclose(true_tip_m(graph.arm), [0.22, 0.03, 0.12], atol=0.004))
    graph.wait_until_still()
    np.testing.assert_allclose(true_tip_m(graph.arm), [0.22, 0.03, 0.12], atol=0.004)


@pytest.mark.full
def test_ros_twist_moves_tip_until_messages_stop(graph):
    start_m, twist = true_tip_m(graph.arm), TwistStamped()
    twist.twist.linear.z = 0.05

    def has_moved():
        graph.publish("/servo_twist", twist)
        return true_tip_m(graph.arm)[2] > start_m[2] + 0.03

    until(has_moved)
    graph.wait_until_still()
    moved_m = true_tip_m(graph.arm) - start_m
    assert 0.03 < moved_m[2] < 0.15
    assert np.abs(moved_m[:2]).max() < 0.01


@pytest.mark.full
def test_ros_stop_latches_until_acknowledged(graph):
    start = true_joints(graph.arm)["wrist_roll"]
    graph.publish("/joint_trajectory", trajectory("wrist_roll", (20.0, start + 1.0)))
    until(lambda: true_joints(graph.arm)["wrist_roll"] > start + 0.05)
    response, sequence = graph.call("/stop")
    assert (response.success, sequence) == (True, graph._sent)
    graph.wait_until_still()
    held = true_joints(graph.arm)["wrist_roll"]
    assert held < start + 0.8
    graph.next("/diagnostics", DiagnosticArray, lambda found: "ROS 2" in found.status[0].message)
    graph.publish("/joint_trajectory", trajectory("wrist_roll", (0.5, start)))
    until(lambda: graph.warnings and "acknowledge" in graph.warnings[-1])
    assert true_joints(graph.arm)["wrist_roll"] == pytest.approx(held, abs=0.01)
    assert not graph.call("/hold")[0].success
    assert graph.call("/acknowledge")[0].success
    graph.publish("/joint_trajectory", trajectory("wrist_roll", (0.5, start)))
    until(lambda: true_joints(graph.arm)["wrist_roll"] < held - 0.02)


def test_ros_stop_reports_torque_of_servos(graph):
    def stopped(torque):
        until(lambda: all(joint.torque is torque for joint in graph.bridge._joints))
        response, _ = graph.call("/stop")
        return response.message, graph.arm.stop_reason.text

    holding = stopped(True)
    graph.arm.acknowledge()
    graph.arm.disable_torque()
    limp = stopped(False)
    graph.arm.acknowledge()
    graph.arm.enable()
    assert holding[0].endswith("until /acknowledge is called; torque stays on.")
    assert limp[0].endswith("until /acknowledge is called; torque is off; the arm is limp.")
    assert holding[1] == limp[1] == "Stopped from ROS 2."


def test_ros_stop_by_other_node_ends_queued_goal(graph, monkeypatch):
    before, waits, goes_on = true_joints(graph.arm), threading.Event(), threading.Event()

    def wait(*_):
        waits.set()
        assert goes_on.wait(60)

    with open_router_client(Endpoint("tcp", HOST, graph.port), None) as session:
        other = Graph(graph.port, graph.arm, session, graph.warnings)
        with monkeypatch.context() as patch:
            patch.setattr("ikservo.apps.remote.ros.bridge.check_age", wait)
            graph.publish("/joint_trajectory", trajectory("wrist_roll", (0.5, 1.0)))
            assert waits.wait(60)
            assert other.call("/stop")[0].success
            assert graph.call("/acknowledge")[0].success
            goes_on.set()
            until(lambda: graph.warnings)
    assert "stopped after this motion had been requested" in graph.warnings[-1]
    graph.wait_until_still()
    assert true_joints(graph.arm) == pytest.approx(before, abs=0.01)


def test_ros_stop_is_obeyed_while_other_services_are_busy(graph):
    busy, goes_on = [], threading.Event()

    def wait():
        busy.append(True)
        goes_on.wait(60)
        return ""

    key, request = graph.key("/hold", Trigger), Trigger.Request().serialize()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(graph.arm, "hold", wait)
        held = [  # more than are kept
            graph._session.get(key, payload=request, attachment=graph.attachment())
            for _ in range(30)
        ]
        until(lambda: len(busy) == 4)
        (reply,) = graph._session.get(graph.key("/stop", Trigger), payload=request)
        goes_on.set()
        for replies in held:  # one that is late would end the goal of the next test
            list(replies)
    assert Trigger.Response.deserialize(reply.ok.payload.to_bytes()).success
    assert graph.arm.stop_reason is not None


def test_repeated_ros_goal_is_dropped(graph):
    start = true_joints(graph.arm)["wrist_roll"]
    message, sent = trajectory("wrist_roll", (0.5, start + 0.1)), graph.attachment()
    graph.publish("/joint_trajectory", message, attachment=sent)
    until(lambda: true_joints(graph.arm)["wrist_roll"] > start + 0.05)
    graph.wait_until_still()
    graph.publish("/joint_trajectory", message, attachment=sent)
    until(lambda: graph.warnings and "arrived twice" in graph.warnings[-1])
    assert not graph.bridge._driver.is_moving


def test_ros_read_error_is_reported_and_joint_states_continue(graph, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(graph.arm, "where", lambda: 1 / 0)
        graph.next("/diagnostics", DiagnosticArray,
                   lambda found: "ZeroDivisionError" in found.status[0].message)  # fmt: skip
    graph.next("/joint_states", JointState)
    graph.bridge._warning = ""


def test_unexpected_error_ends_motion_but_not_ros_bridge(graph, monkeypatch):
    start = true_joints(graph.arm)["wrist_roll"]
    goal = trajectory("wrist_roll", (0.5, start + 0.1))
    with monkeypatch.context() as patch:
        patch.setattr(graph.arm, "stream", lambda **_: 1 / 0)
        graph.publish("/joint_trajectory", goal)
        until(lambda: graph.warnings and "ZeroDivisionError" in graph.warnings[-1])
        graph.wait_until_still()
    graph.publish("/joint_trajectory", goal)
    until(lambda: true_joints(graph.arm)["wrist_roll"] > start + 0.05)


@pytest.mark.parametrize(
    ("message", "how", "found"),
    [
        (trajectory("wrist_roll", (1.0, 9.0)), {}, "outside"),
        (trajectory("wrist_roll", (1.0, 0.5)), {"attachment": None}, "attachment"),
        (trajectory("wrist_roll", (1.0, 0.5)), {"attachment": b"short"}, "attachment"),
        (String(data="no trajectory"), {}, "JointTrajectory"),
    ],
)
def test_unusable_ros_message_is_reported_and_moves_nothing(graph, message, how, found):
    before = true_joints(graph.arm)
    how = {"attachment": graph.attachment(), **how}
    key = graph.key("/joint_trajectory", JointTrajectory)
    graph._session.put(key, message.serialize(), **how)
    until(lambda: graph.warnings and found in graph.warnings[-1])
    assert not graph.bridge._driver.is_moving
    assert true_joints(graph.arm) == pytest.approx(before, abs=0.03)


def test_ros_robot_description_reaches_late_subscribers(graph):
    found = []
    with zenoh.ext.declare_advanced_subscriber(
        graph._session, graph.key("/robot_description", String), found.append,
        history=zenoh.ext.HistoryConfig(detect_late_publishers=True),
    ):  # fmt: skip
        until(lambda: found)
    text = String.deserialize(found[0].payload.to_bytes()).data
    assert text == graph.arm.model.path.with_suffix(".urdf").read_text()


@pytest.mark.full
def test_motion_ends_if_ros_router_is_lost():
    port = find_free_port()
    with contextlib.ExitStack() as stack:
        lost = stack.enter_context(router(port))
        graph = stack.enter_context(bridged(port))
        start = true_joints(graph.arm)["wrist_roll"]
        graph.publish("/joint_trajectory", trajectory("wrist_roll", (20.0, start + 1.0)))
        until(lambda: true_joints(graph.arm)["wrist_roll"] > start + 0.05)
        lost.close()
        until(lambda: graph.arm.stop_reason is not None)
        graph.wait_until_still()
        assert true_joints(graph.arm)["wrist_roll"] < start + 0.8
        assert "router was lost" in graph.arm.stop_reason.text


@pytest.mark.full
def test_remote_arm_is_bridged_to_ros(graph):
    own = Endpoint("tcp", HOST, graph.port)
    with (
        serve(find_free_port()) as served,
        open_router_client(own, None) as session,
        served.open() as remote,
        RosBridge(session, remote, namespace="/far", speed="fast") as bridge,
    ):
        served.server.lease.timeout_s = TIMEOUT_S
        start = true_joints(served.arm)["wrist_roll"]
        message = trajectory("wrist_roll", (1.0, start + 0.3))
        graph.publish("/far/joint_trajectory", message)
        until(lambda: true_joints(served.arm)["wrist_roll"] > start + 0.2)
        assert graph.call("/far/stop")[0].success
        until(lambda: served.arm.stop_reason is not None)
        until(lambda: not bridge._driver.is_moving)


@pytest.mark.parametrize(
    ("words", "code", "text"),
    [
        ("--port sim --router 127.0.0.1:9", 3, "Start it: ros2 run rmw_zenoh_cpp"),
        ("--port sim --router a/b/c", 2, "Expected"),
        ("--port sim --namespace 3d", 2, "namespace"),
        ("--port sim --domain 300", 2, "--domain"),
        ("--port sim --speed warp", 2, "warp"),
    ],
)
def test_bad_ros_command_gives_one_clear_error(graph, capsys, monkeypatch, words, code, text):
    monkeypatch.setattr("ikservo.apps.remote.zenoh_session._CONNECT_TIMEOUT_S", 0.3)
    given = words if "--router" in words else f"{words} --router {HOST}:{graph.port}"
    assert main(["ros", "so101", *given.split()]) == code
    captured = capsys.readouterr()
    assert text in captured.out + captured.err


def test_error_names_invalid_ros_domain_id(monkeypatch, capsys):
    monkeypatch.setenv("ROS_DOMAIN_ID", "x")
    assert main(["ros", "so101", "--port", "sim"]) == 2
    assert "ROS_DOMAIN_ID" in capsys.readouterr().err


def test_signal_during_ros_announcement_exits_with_0(graph, monkeypatch):
    monkeypatch.setattr(
        "ikservo.apps.remote.ros_command._announce",
        lambda *_, **__: signal.raise_signal(signal.SIGINT),
    )
    assert main(["ros", "so101", "--port", "sim", "--router", f"{HOST}:{graph.port}"]) == 0


@pytest.mark.full
@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_ros_command_joins_graph_and_ends_by_ctrl_c(graph):
    argv = [sys.executable, "-c", CONSOLE, "ros", "so101", "--port", "sim", "--json",
            "--domain", "3", "--namespace", "left", "--router", f"{HOST}:{graph.port}"]  # fmt: skip
    with subprocess.Popen(argv, stdout=subprocess.PIPE, text=True) as process:
        said = json.loads(process.stdout.readline())
        assert "/left/joint_states" in said["outputs"]
        tokens = graph._session.liveliness().get("@ros2_lv/3/**")
        assert any("%left%joint_trajectory" in str(each.ok.key_expr) for each in tokens)
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0
