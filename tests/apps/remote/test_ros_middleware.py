"""Messages to and from a real ROS 2 (rclpy with Fast DDS from PyPI, in Python 3.12)."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from ikservo.errors import InputError
from ikservo.ros_messages.message_types import decode, encode, make
from tests.hardware.test_vendor_packages import UNREACHABLE

PACKAGES = ("rclpy", "rmw-fastrtps-cpp", "sensor-msgs", "std-srvs", "trajectory-msgs")
PEER = """
import json, sys
from importlib import import_module
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

def type_of(kind):
    package, group, name = kind.split("/")
    outer, _, inner = name.partition("_")
    found = getattr(import_module(f"{package}.{group}"), outer)
    return getattr(found, inner) if inner else found

points = [JointTrajectoryPoint(positions=[0.5, float(i)]) for i in range(20)]
made = [JointState(name=["a"], position=[1.5]),
        JointTrajectory(joint_names=["a", "b"], points=points)]
returned = [serialize_message(deserialize_message(bytes.fromhex(data), type_of(kind)))
            for kind, data in json.load(sys.stdin)]
print(json.dumps([bytes(data).hex() for data in map(serialize_message, made)]))
print(json.dumps([bytes(data).hex() for data in returned]))
"""


def python_3_12():
    pyenv = sorted(Path.home().glob(".pyenv/versions/3.12.*/bin/python3.12"))
    for python in (sys.executable, shutil.which("python3.12"), *pyenv):
        version = [python, "-c", "import sys; sys.exit(sys.version_info[:2] != (3, 12))"]
        if python and subprocess.run(version, check=False, capture_output=True).returncode == 0:
            return python
    pytest.skip("the packages of ROS 2 Jazzy need Python 3.12")


@pytest.fixture(scope="module")
def ros(request):
    """Return the Python of an environment with ROS 2, created once and kept."""
    fcntl = pytest.importorskip("fcntl")
    folder = Path(request.config.cache.mkdir("ros_jazzy"))
    python = folder / "bin" / "python"
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / "installed").exists():
            subprocess.run([python_3_12(), "-m", "venv", folder], check=True)
            install = [python, "-m", "pip", "install", "--quiet", "--retries=1"]
            command = [*install, *(f"ros-jazzy-{package}" for package in PACKAGES), "numpy"]
            run = subprocess.run(command, check=False, capture_output=True, text=True)
            if run.returncode and any(reason in run.stderr for reason in UNREACHABLE):
                pytest.skip("the package registry cannot be reached")
            assert run.returncode == 0, run.stderr
            whole = [python, "-c", "import rclpy, std_msgs.msg, sensor_msgs.msg"]
            if subprocess.run(whole, check=False, capture_output=True).returncode:
                pytest.skip("the packages of the registry do not make a whole ROS 2")
            (folder / "installed").touch()
    return python


@pytest.fixture(scope="module")
def exchanged(ros):
    """Return the messages of rclpy, and its copies of each of our messages."""
    sent = [(kind, encode(kind, message).hex()) for kind, message in OURS]
    run = subprocess.run([ros, "-c", PEER], input=json.dumps(sent), check=False, timeout=100,
                         capture_output=True, text=True)  # fmt: skip
    assert run.returncode == 0, run.stderr
    return [[bytes.fromhex(data) for data in json.loads(line)] for line in run.stdout.splitlines()]


def header(frame):
    stamp = make("builtin_interfaces/msg/Time", sec=5, nanosec=7)
    return make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def joint_state(name):
    numbers = {field: np.array([0.25, -1.5]) for field in ("position", "velocity", "effort")}
    return make("sensor_msgs/msg/JointState", header=header("base"), name=[name, "b"], **numbers)


def transform():
    rotation = make("geometry_msgs/msg/Quaternion", x=0.0, y=0.6, z=0.0, w=0.8)
    translation = make("geometry_msgs/msg/Vector3", x=1.0, y=2.0, z=3.0)
    turned = make("geometry_msgs/msg/Transform", translation=translation, rotation=rotation)
    return make("geometry_msgs/msg/TransformStamped", header=header("base"),
                child_frame_id="tip", transform=turned)  # fmt: skip


OURS = [
    *(("sensor_msgs/msg/JointState", joint_state("a" * length)) for length in range(1, 9)),
    ("geometry_msgs/msg/TransformStamped", transform()),
    ("std_msgs/msg/String", make("std_msgs/msg/String", data="<robot/>")),
    ("std_srvs/srv/Trigger_Response",
     make("std_srvs/srv/Trigger_Response", success=True, message="done")),
]  # fmt: skip


@pytest.mark.campaign
def test_rclpy_decodes_every_message_of_ikservo(exchanged):
    for (kind, message), returned in zip(OURS, exchanged[1], strict=True):
        assert encode(kind, decode(kind, returned)) == encode(kind, message)


@pytest.mark.full
def test_joint_state_serialized_by_rclpy_is_decoded(exchanged):
    message = decode("sensor_msgs/msg/JointState", exchanged[0][0])
    assert (message.name, list(message.position), len(message.effort)) == (["a"], [1.5], 0)


@pytest.mark.full
def test_trajectory_serialized_by_rclpy_is_decoded(exchanged):
    message = decode("trajectory_msgs/msg/JointTrajectory", exchanged[0][1])
    assert [list(point.positions) for point in message.points] == [[0.5, i] for i in range(20)]


def test_trailing_bytes_of_ros_message_are_ignored():
    data = encode("std_msgs/msg/String", make("std_msgs/msg/String", data="arm"))
    assert decode("std_msgs/msg/String", data + b"\xff" * 40).data == "arm"


@pytest.mark.parametrize("missing", range(1, 12))
def test_truncated_ros_message_is_refused(missing):
    data = encode("std_msgs/msg/String", make("std_msgs/msg/String", data="arm"))
    with pytest.raises(InputError, match="Not a message of type std_msgs/msg/String"):
        decode("std_msgs/msg/String", data[:-missing])
