"""Websocket clients that send exactly the bytes a test gives."""

import json
from contextlib import ExitStack

import websockets
from websockets.sync.client import connect

from ikservo.apps.page.messages.page_messages import read_message
from ikservo.apps.page.server.auth import challenge_response
from ikservo.apps.page.server.server import PageChannel


class RecordingController:
    """A controller that records what it receives."""

    def __init__(self):
        self.forget()

    def forget(self):
        self.received, self.present, self.rights, self.show = [], set(), [], []

    def connect(self, right):
        self.rights.append(right)
        self.present.add(len(self.rights))
        return len(self.rights)

    def disconnect(self, client):
        self.present.discard(client)

    def receive(self, client, message):
        self.received.append(message)

    def frames(self, client):
        return [{"kind": "scene", "items": self.show}]


def arm_channel(backend):
    """Return the channel of a page's arm, handled by a backend."""
    return PageChannel("/live", lambda arm: None if arm else backend, read_message)


class SocketClient:
    """A websocket client whose messages a test chooses."""

    def __init__(self, url, path="/live", **options):
        address = url.replace("http", "ws") + path
        opening = connect(address, **{"origin": url, "proxy": None, **options})
        self._exits = ExitStack()
        self.socket = self._exits.enter_context(opening)
        self.seq = 0
        self.nonce = ""
        try:
            self.nonce = self.receive_message()["nonce"]
        except websockets.ConnectionClosed:
            self.close()
            raise

    def send(self, text):
        self.socket.send(text)

    def prove(self, key):
        self.send(json.dumps({"kind": "hello", "proof": challenge_response(key, self.nonce)}))
        return self

    def send_message(self, kind, seen=0, **fields):
        self.seq += 1
        self.send(json.dumps({"kind": kind, "seq": self.seq, "seen": seen, **fields}))

    def receive_message(self):
        return json.loads(self.socket.recv(timeout=10))

    def receive_kind(self, kind):
        """Return the next message of a kind."""
        while True:
            message = self.receive_message()
            if message["kind"] == kind:
                return message

    def closing_code(self):
        """Return the code with which the server closes the connection."""
        try:
            while True:
                self.receive_message()
        except websockets.ConnectionClosed as closed:
            return closed.rcvd.code if closed.rcvd else 1006

    def close(self):
        self._exits.close()
