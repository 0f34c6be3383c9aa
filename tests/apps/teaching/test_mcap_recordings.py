"""MCAP recordings are readable by other programs, survive a kill, and are replayed."""

import json
import struct
import time
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from websockets.sync.client import connect

import ikservo
from ikservo.apps.teaching.live_view import FoxgloveServer
from ikservo.apps.teaching.mcap_recording import read_attachment
from ikservo.apps.teaching.recorder import RecordSettings, describe_arm, read_recording, record
from ikservo.apps.teaching.recording import ArmSample
from ikservo.errors import BadValueError, FileFormatError, InputError, PortError
from ikservo.model import load_model
from ikservo.ros_messages.arm_messages import DESCRIPTION, JOINT_STATES, ArmMessages
from servosim.clock import VirtualClock
from tests.oracle import tip_from_joints

pytestmark = pytest.mark.full  # the fixture takes long

ROLL = {"wrist_roll": 0.5}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Return the recording of an arm that holds, its state behind, and the number of samples."""
    path = tmp_path_factory.mktemp("recorded") / "wave.mcap"
    with ikservo.open_arm("so101", port="sim:?pose=home") as arm:
        arm.move_joints(ROLL)
        samples = arm.record(path, duration_s=1.5).samples
        return path, arm.where(), samples


def messages(path):
    """Return the messages by topic, as mcap-ros2-support reads them."""
    found = {}
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages():
            found.setdefault(channel.topic, []).append(message)
    return found


def matrix(transform):
    """Return the matrix (4, 4) of a geometry_msgs/Transform, by the quaternion product."""
    x, y, z, w = (getattr(transform.rotation, name) for name in "xyzw")
    left = np.array([[w, -z, y, x], [z, w, -x, y], [-y, x, w, z], [-x, -y, -z, w]])
    right = np.array([[w, -z, y, -x], [z, w, -x, -y], [-y, x, w, -z], [x, y, z, w]])
    T = left @ right
    T[:3, 3] = [getattr(transform.translation, name) for name in "xyz"]
    return T


def test_mcap_joints_goals_poses_and_health_are_readable(recorded):
    path, state, samples = recorded
    found = messages(path)
    assert {topic: len(rows) for topic, rows in found.items()} == {
        "/joint_states": samples, "/ikservo/goal": samples, "/tf": samples, "/diagnostics": 2,
        "/robot_description": 1}  # fmt: skip
    joints, goal = found["/joint_states"][-1], found["/ikservo/goal"][-1]
    assert tuple(joints.name) == state.names
    np.testing.assert_allclose(joints.position, state.positions_rad, atol=0.002)
    assert dict(zip(goal.name, goal.position, strict=True))["wrist_roll"] == pytest.approx(
        0.5, abs=0.03
    )
    health = {row.name: row for row in found["/diagnostics"][-1].status}
    assert {pair.key: pair.value for pair in health["so101"].values} == {"torque": "on"}
    servo = {pair.key: pair.value for pair in health["so101: elbow_flex"].values}
    assert float(servo["temperature [°C]"]) == state["elbow_flex"].temperature_c


def test_mcap_link_poses_add_up_to_tip_position(recorded):
    path, _, _ = recorded
    found = messages(path)
    rows = {row.child_frame_id: row for row in found["/tf"][0].transforms}
    T, link = np.eye(4), load_model("so101").chain.tip
    while link != "base":
        T, link = matrix(rows[link].transform) @ T, rows[link].header.frame_id
    joints = found["/joint_states"][0]
    positions = dict(zip(joints.name, joints.position, strict=True))
    np.testing.assert_allclose(T[:3, 3], tip_from_joints("so101", positions), atol=1e-9)


def test_mcap_messages_carry_wall_clock_time_of_sample(tmp_path):
    started_ns = []

    def look(elapsed_s):
        started_ns.append(time.time_ns() - round(1e9 * elapsed_s))

    Tape(tmp_path / "wave.mcap", 0.1, look)
    with (tmp_path / "wave.mcap").open("rb") as file:
        first, *_ = make_reader(file).iter_messages(topics=["/joint_states"])
    assert started_ns[0] <= first[2].log_time <= started_ns[0] + 1_000_000_000


def test_mcap_link_transforms_depend_on_jaw_position():
    model = load_model("so101")
    said = ArmMessages(model, model.chain)
    closed, opened = dict(model.pose("home")), {**model.pose("home"), "gripper": 1.0}
    assert said.transforms(0, closed).data != said.transforms(0, opened).data


def test_rosbags_reads_mcap_recording(recorded):
    path, state, samples = recorded
    with AnyReader([path]) as reader:
        rows = [(connection.topic, reader.deserialize(raw, connection.msgtype))
                for connection, _, raw in reader.messages()]  # fmt: skip
    joints = [message for topic, message in rows if topic == "/joint_states"]
    assert len(joints) == samples
    np.testing.assert_allclose(joints[-1].position, state.positions_rad, atol=0.002)


def test_mcap_attaches_description_arm_file_and_version(recorded):
    path, _, _ = recorded
    model = load_model("so101")
    with path.open("rb") as file:
        reader = make_reader(file)
        attached = {each.name: each.data.decode() for each in reader.iter_attachments()}
        (metadata,) = reader.iter_metadata()
    assert attached["robot.urdf"] == model.path.with_suffix(".urdf").read_text()
    assert attached["arm.toml"] == model.path.read_text()
    assert metadata.metadata["ikservo"] == ikservo.__version__
    assert messages(path)["/robot_description"][0].data == attached["robot.urdf"]


class Tape:
    """Records synthetic samples of an arm and inspects the file meanwhile."""

    def __init__(self, path, duration_s, look=lambda elapsed_s: None):
        self.clock, self.times_s = VirtualClock(), []
        self.model = load_model("so101")
        self.joints = []
        self.look = look
        arm = describe_arm(self.model, self.model.chain, 0.02, ikservo.arm.ZeroSource.SIMULATED)
        record(self.measure, self.clock, arm, RecordSettings(path, duration_s))

    def measure(self):
        elapsed_s = self.clock.now_s()
        self.look(elapsed_s)
        self.times_s.append(elapsed_s)
        home = np.array([self.model.pose("home")[joint.name] for joint in self.model.joints])
        self.joints.append(home + 0.1 * np.sin(elapsed_s))
        return ArmSample(self.joints[-1])


def test_killed_mcap_recording_loses_at_most_one_second(tmp_path):
    path, kept = tmp_path / "wave.mcap", []

    def look(elapsed_s):
        if round(elapsed_s / 0.02) % 7 == 5:
            (tmp_path / "copy.mcap").write_bytes(path.read_bytes())
            kept.append(elapsed_s - float(read_recording(tmp_path / "copy.mcap").times_s[-1]))

    Tape(path, 3.5, look)
    assert len(kept) > 20
    assert max(kept) <= 1.0 + 1e-6


def test_truncated_mcap_is_read_up_to_its_last_whole_second(tmp_path):
    path, copy = tmp_path / "wave.mcap", tmp_path / "copy.mcap"
    tape = Tape(path, 5.0)
    data, lengths = path.read_bytes(), []
    for size in range(len(data), 0, -1999):
        copy.write_bytes(data[:size])
        try:
            read = read_recording(copy)
        except FileFormatError:
            lengths.append(0)
            continue
        lengths.append(len(read.times_s))
        np.testing.assert_array_equal(read.joints, tape.joints[: lengths[-1]])
        np.testing.assert_allclose(read.times_s, tape.times_s[: lengths[-1]], atol=1e-9)
    assert lengths == sorted(lengths, reverse=True)
    assert len(set(lengths)) >= 5


def test_damaged_mcap_is_read_up_to_damage_with_warning(tmp_path):
    path = tmp_path / "wave.mcap"
    tape = Tape(path, 3.0)
    data = bytearray(path.read_bytes())
    with path.open("rb") as file:
        chunk = make_reader(file).get_summary().chunk_indexes[1]
    data[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 0xFF
    path.write_bytes(data)
    with pytest.warns(RuntimeWarning, match="damaged near byte"):
        read = read_recording(path)
    assert 0 < len(read.times_s) < len(tape.times_s)
    np.testing.assert_array_equal(read.joints, tape.joints[: len(read.times_s)])


def test_mcap_and_json_lines_recordings_replay_equally(tmp_path):
    tapes = {suffix: Tape(tmp_path / f"wave.{suffix}", 1.0) for suffix in ("mcap", "jsonl")}
    with ikservo.open_arm("so101", port="sim:?pose=home") as arm:
        read = {suffix: arm.load_replay(tmp_path / f"wave.{suffix}")[1] for suffix in tapes}
        times_s = np.linspace(0.0, read["mcap"].duration_s, 20)
        positions = {
            suffix: [played.state(time_s).position for time_s in times_s]
            for suffix, played in read.items()
        }
        np.testing.assert_allclose(positions["mcap"], positions["jsonl"], atol=1e-5)
        assert arm.replay(tmp_path / "wave.mcap").error_rad < 0.01


def write_bag(folder, rows):
    """Write joint states as ROS 2 does, from rows of time [s], names and positions."""
    store = get_typestore(Stores.ROS2_JAZZY)
    kind, types = "sensor_msgs/msg/JointState", store.types
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/joint_states", kind, typestore=store)
        for time_s, names, positions in rows:
            ns = round(time_s * 1e9)
            stamp = types["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
            message = types[kind](
                header=types["std_msgs/msg/Header"](stamp=stamp, frame_id=""), name=names,
                position=np.array(positions), velocity=np.zeros(0), effort=np.zeros(0),
            )  # fmt: skip
            writer.write(connection, ns, store.serialize_cdr(message, kind))
    return next(Path(folder).glob("*.mcap"))


@pytest.mark.parametrize("order", [sorted, list], ids=["as they come", "one after the other"])
def test_ros_2_bag_is_replayed_with_any_order_and_extra_joints(tmp_path, order):
    home = load_model("so101").pose("home")
    arm_rows = [
        (5.0 + 0.1 * k, ["wheel", *reversed([n for n in home if n != "gripper"])],
         [k, *reversed([home[n] + 0.01 * k for n in home if n != "gripper"])]) for k in range(8)
    ]  # fmt: skip
    jaw = [(4.95 + 0.1 * k, ["gripper"], [home["gripper"]]) for k in range(8)]
    path = write_bag(tmp_path / "bag", order(arm_rows + jaw))
    with ikservo.open_arm("so101", port="sim:?pose=home") as arm:
        recording, _ = arm.load_replay(path)
        assert recording.header.joints == arm.joint_names
        last = dict(zip(arm.joint_names, recording.joints[-1], strict=True))
        assert last["elbow_flex"] == pytest.approx(home["elbow_flex"] + 0.07)
        assert last["gripper"] == home["gripper"]


@pytest.mark.parametrize(
    ("rows", "found"),
    [
        ([(1.0, ["a"], [0.0])], "has no shoulder_pan"),
        ([(1.0, ["a"], [np.nan])], "sample 1: has a wrong number of positions"),
        ([(1.0, ["a", "b"], [1.0])], "sample 1: has a wrong number of positions"),
        ([(1.0, ["a"], [0.0]), (1e6, ["a"], [0.0])], "the last sample: is too late"),
        ([], "has no sample"),
    ],
)
def test_ros_bag_that_cannot_be_replayed_is_refused(tmp_path, rows, found):
    path = write_bag(tmp_path / "bag", rows)
    with (
        ikservo.open_arm("so101", port="sim:?pose=home") as arm,
        pytest.raises(FileFormatError, match=found),
    ):
        arm.replay(path)


def test_mcap_recording_of_another_arm_is_refused(tmp_path, recorded):
    with (
        ikservo.open_arm("so100", port="sim:?pose=home") as arm,
        pytest.raises(FileFormatError, match="arm so101"),
    ):
        arm.replay(recorded[0])


def test_existing_mcap_file_is_kept_without_overwrite(tmp_path):
    path = tmp_path / "wave.mcap"
    path.write_text("precious")
    with ikservo.open_arm("so101", port="sim") as arm:
        with pytest.raises(InputError, match="exists"):
            arm.record(path, duration_s=0.1)
        assert path.read_text() == "precious"
        arm.record(path, duration_s=0.1, overwrite=True)
    assert read_attachment(path, "arm.toml")


def test_foxglove_shows_joints_and_description_live():
    model = load_model("so101")
    said, home = ArmMessages(model, model.chain), model.pose("home")
    server = FoxgloveServer(0, "SO-101")
    try:
        server.publish(said.description(1, "<robot/>"))
        server.publish(said.joint_states(2, home))
        with connect(
            f"ws://127.0.0.1:{server.port}", subprotocols=["foxglove.sdk.v1"], open_timeout=10
        ) as socket:
            channels = {}
            while {JOINT_STATES.name, DESCRIPTION.name} - channels.keys():
                news = json.loads(socket.recv(10))
                channels |= {each["topic"]: each for each in news.get("channels", ())}
            wanted = [{"id": k, "channelId": channels[topic.name]["id"]}
                      for k, topic in enumerate((JOINT_STATES, DESCRIPTION))]  # fmt: skip
            socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
            seen = {}
            while len(seen) < 2:
                server.publish(said.joint_states(3, home))
                try:
                    data = socket.recv(0.05)
                except TimeoutError:
                    continue
                if isinstance(data, bytes) and data[0] == 1:
                    seen[struct.unpack_from("<I", data, 1)[0]] = data[13:]
    finally:
        server.close()
    assert channels[JOINT_STATES.name]["schemaName"] == JOINT_STATES.kind
    assert seen == {0: said.joint_states(3, home).data, 1: said.description(1, "<robot/>").data}


def test_foxglove_port_in_use_prevents_recording(tmp_path):
    server = FoxgloveServer(0, "first")
    try:
        with ikservo.open_arm("so101", port="sim") as arm, pytest.raises(PortError, match="port"):
            arm.record(tmp_path / "wave.mcap", duration_s=0.1, foxglove_port=server.port)
    finally:
        server.close()
    assert not (tmp_path / "wave.mcap").exists()


def test_foxglove_refuses_json_lines_recording(tmp_path):
    with ikservo.open_arm("so101", port="sim") as arm, pytest.raises(BadValueError, match="mcap"):
        arm.record(tmp_path / "wave.jsonl", duration_s=0.1, foxglove_port=0)
    assert not (tmp_path / "wave.jsonl").exists()
