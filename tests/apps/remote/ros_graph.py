"""A bridged arm in a ROS 2 graph, and a node of another implementation."""

import contextlib
import json
import struct
import time

import zenoh
from ros2_pyterfaces.cyclone.builtin_interfaces.msg import Duration
from ros2_pyterfaces.cyclone.std_srvs.srv import Trigger
from ros2_pyterfaces.cyclone.trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from zenoh_ros2_sdk.keyexpr import topic_keyexpr
from zenoh_ros2_sdk.utils import ros2_to_dds_type

import ikservo
from ikservo.apps.remote.address import Endpoint
from ikservo.apps.remote.ros.bridge import RosBridge
from ikservo.apps.remote.zenoh_session import open_router_client
from tests.apps.remote.conftest import until

HOST = "127.0.0.1"


@contextlib.contextmanager
def router(port):
    """A Zenoh router, as rmw_zenohd is."""
    config = zenoh.Config()
    for key, value in {
        "mode": "router", "listen/endpoints": [f"tcp/{HOST}:{port}"],
        "scouting/multicast/enabled": False, "transport/link/tx/lease": 1000,
    }.items():  # fmt: skip
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config) as session:
        yield session


class Graph:
    """A bridged arm, and a node of another implementation.

    Attributes:
        arm: The simulated arm.
        warnings: Messages that the bridge has refused.
    """

    def __init__(self, port, arm, session, warnings):
        self.port, self.arm, self._session, self.warnings = port, arm, session, warnings
        self._sent = 0

    def key(self, name, kind):
        """Return a key expression as the SDK builds it, with the hash by ros2-pyterfaces."""
        dds = ros2_to_dds_type(kind.get_type_name())
        return topic_keyexpr(0, name, dds, kind.hash_rihs01())

    def attachment(self):
        self._sent += 1
        return struct.pack("<qqB16s", self._sent, time.time_ns(), 16, b"g" * 16)

    def publish(self, name, message, **how):
        how = {"attachment": self.attachment(), **how}
        self._session.put(self.key(name, type(message)), message.serialize(), **how)

    def call(self, name):
        """Call a trigger service; return its response and the sequence in its attachment."""
        (reply,) = self._session.get(
            self.key(name, Trigger), payload=Trigger.Request().serialize(),
            attachment=self.attachment(), target=zenoh.QueryTarget.ALL_COMPLETE,
        )  # fmt: skip
        sequence = struct.unpack_from("<q", reply.ok.attachment.to_bytes())[0]
        return Trigger.Response.deserialize(reply.ok.payload.to_bytes()), sequence

    def next(self, name, kind, accept=lambda message: True, within_s=60.0):
        """Return the next accepted message of a topic."""
        found = []

        def take(sample):
            message = kind.deserialize(sample.payload.to_bytes())
            if not found and accept(message):
                found.append((message, sample))

        with self._session.declare_subscriber(self.key(name, kind), take):
            until(lambda: found, within_s)
        return found[0]

    def wait_until_still(self):
        until(lambda: not self.bridge._driver.is_moving)


def trajectory(joint, *points):
    rows = [JointTrajectoryPoint(positions=[q], time_from_start=Duration(
        sec=int(s), nanosec=int(s % 1 * 1e9))) for s, q in points]  # fmt: skip
    return JointTrajectory(joint_names=[joint], points=rows)


@contextlib.contextmanager
def bridged(port):
    """A bridged arm."""
    warnings = []
    with (
        open_router_client(Endpoint("tcp", HOST, port), None) as own,
        open_router_client(Endpoint("tcp", HOST, port), None) as other,
        ikservo.open_arm("so101", port="sim:?pose=home") as arm,
        RosBridge(own, arm, speed="fast", warn=warnings.append) as bridge,
    ):
        graph = Graph(port, arm, other, warnings)
        graph.bridge = bridge
        yield graph
