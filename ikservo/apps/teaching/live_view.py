"""Show a recording live in Foxglove, through its websocket server on this machine only."""

from __future__ import annotations

import importlib
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from ikservo.errors import BadValueError, IkservoError, PortError
from ikservo.remedies import install_command
from ikservo.ros_messages.arm_messages import RosMessage, Topic
from ikservo.ros_messages.message_types import definition

if TYPE_CHECKING:
    from foxglove import Channel
    from foxglove.websocket import ChannelView, Client

FOXGLOVE_PORT = 8765
"""The TCP port on which Foxglove expects a server."""


def _listener(on_subscribe: Callable[[str], None]) -> object:
    from foxglove.websocket import ServerListener  # noqa: PLC0415  # an extra

    class Listener(ServerListener):
        def on_subscribe(self, client: Client, channel: ChannelView) -> None:
            on_subscribe(channel.topic)

    return Listener()


class FoxgloveServer:
    """Server that sends messages to all connected Foxglove clients.

    Args:
        port: The TCP port, on this machine only; 0 for any free port.
        name: The name that Foxglove shows.

    Attributes:
        port: The port on which the server listens.

    Raises:
        PortError: The port is in use.
        IkservoError: The extra ``foxglove`` is not installed.
    """

    def __init__(self, port: int, name: str) -> None:
        if not 0 <= port <= 65535:
            raise BadValueError("The port", port, "a number from 0 to 65535")
        try:
            self._module: Any = importlib.import_module("foxglove")  # from an extra
        except ImportError:
            raise IkservoError(
                "Foxglove needs the package foxglove-sdk, which is not installed.",
                f"Install it: {install_command('foxglove')}",
            ) from None
        self._context = self._module.Context()
        self._channels: dict[Topic, Channel] = {}
        self._latched: dict[str, RosMessage] = {}
        self._wanted: set[str] = set()
        self._lock = threading.Lock()
        try:
            self._server = self._module.start_server(
                name=name,
                host="127.0.0.1",
                port=port,
                context=self._context,
                server_listener=_listener(self._on_subscribe),
            )
        except (OSError, RuntimeError) as error:
            raise PortError(
                f"Foxglove cannot be served at port {port}: {error}.",
                "Choose another: --foxglove-port 8766",
            ) from None
        self.port = int(self._server.port)

    def publish(self, message: RosMessage) -> None:
        """Send a message to the subscribers of its topic."""
        if message.topic.latched:
            self._latched[message.topic.name] = message
        with self._lock:
            wanted, self._wanted = self._wanted, set[str]()
        for name in wanted & self._latched.keys():
            self._send(self._latched[name])
        self._send(message)

    def flush(self) -> None:
        """Do nothing, because messages are sent at once."""

    def close(self) -> None:
        """Disconnect all clients."""
        self._server.stop()

    def _on_subscribe(self, topic: str) -> None:
        """Send the latest message to a new subscriber; called in a thread of the library."""
        with self._lock:
            self._wanted.add(topic)

    def _send(self, message: RosMessage) -> None:
        if message.topic not in self._channels:
            schema = self._module.Schema(
                name=message.topic.kind,
                encoding="ros2msg",
                data=definition(message.topic.kind).encode(),
            )
            self._channels[message.topic] = self._module.Channel(
                message.topic.name, schema=schema, message_encoding="cdr", context=self._context
            )
        self._channels[message.topic].log(message.data, log_time=message.time_ns)
