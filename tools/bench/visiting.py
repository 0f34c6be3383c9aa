"""A view that is served in this process, and a page that visits it without a browser."""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Generator
from contextlib import ExitStack, contextmanager
from typing import Any

from websockets.sync.client import ClientConnection, connect

from ikservo.apps.page.page_app import ViewApp
from ikservo.apps.page.served_arms import ArmAtPort, ServedArm
from ikservo.apps.page.server.auth import challenge_response
from ikservo.model import load_model

__all__ = ["Page", "served"]


class Page:
    """A client of the page without a browser.

    Attributes:
        url: Address of the page.
        received_bytes: Number of received bytes.
    """

    def __init__(self, socket: ClientConnection, key: str, url: str) -> None:
        self.url = url
        self._socket, self._seq, self._seen = socket, 0, 0
        self.received_bytes = 0
        socket.send(
            json.dumps({"kind": "hello", "proof": challenge_response(key, self.receive()["nonce"])})
        )
        self.say("viewport", w=900, h=700, dpr=1, view="side")

    def receive(self, timeout_s: float = 10.0) -> dict[str, Any]:
        """Return the next message."""
        text = str(self._socket.recv(timeout=timeout_s))
        self.received_bytes += len(text.encode())
        message: dict[str, Any] = json.loads(text)
        if message["kind"] == "scene":
            self._seen = message["seq"]
        return message

    def say(self, kind: str, **fields: object) -> None:
        """Send a message."""
        self._seq += 1
        message = {"kind": kind, "seq": self._seq, "seen": self._seen, **fields}
        self._socket.send(json.dumps(message))

    def point(self, phase: str, x: float, y: float) -> None:
        """Send the pointer's position."""
        self.say("pointer", phase=phase, x=x, y=y, button=0, pointer=1)

    def receive_for(self, seconds: float) -> None:
        """Receive without sending; the next message confirms the last scene."""
        end_s = time.monotonic() + seconds
        with contextlib.suppress(TimeoutError):
            while True:
                self.receive(max(0.0, end_s - time.monotonic()))

    def live_for(self, seconds: float) -> None:
        """Receive scenes and send heartbeats, as a page does."""
        end_s = time.monotonic() + seconds
        while True:
            try:
                if self.receive(max(0.0, end_s - time.monotonic()))["kind"] == "scene":
                    self.say("heartbeat", visible=True)
            except TimeoutError:
                return


@contextmanager
def served(arm: str, pose: str) -> Generator[tuple[ServedArm, Page]]:
    """Serve an arm and connect to it with Live on."""
    house = ViewApp([ArmAtPort(load_model(arm), f"sim:?pose={pose}")], dead_man_s=5.0)
    with ExitStack() as stack:
        urls = stack.enter_context(house)
        stack.enter_context(house.serve_in_thread())
        url = urls.control.partition("/#")[0]
        address = url.replace("http", "ws") + "/live"
        socket = stack.enter_context(connect(address, origin=url, proxy=None))  # pyright: ignore[reportArgumentType]
        page = Page(socket, house.keys.control, url)
        page.say("set_speed", name="fast")
        page.say("set_live", on=True)
        page.live_for(1.5)
        yield house.arms.all()[0], page
