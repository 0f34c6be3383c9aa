"""Visitors of a page's server that are no browsers: they say exactly what a test wants."""

import json
from contextlib import ExitStack

import websockets
from websockets.sync.client import connect

from ikservo.view.auth import challenge_response


class Audience:
    """Stands behind the socket and only remembers."""

    def __init__(self):
        self.forget()

    def forget(self):
        self.heard, self.present, self.rights, self.show = [], set(), [], []

    def connect(self, right):
        self.rights.append(right)
        self.present.add(len(self.rights))
        return len(self.rights)

    def disconnect(self, visitor):
        self.present.discard(visitor)

    def receive(self, visitor, message):
        self.heard.append(message)

    def frames(self, visitor):
        return [{"kind": "scene", "items": self.show}]


class Guest:
    """One websocket whose words a test chooses."""

    def __init__(self, url, **options):
        address = url.replace("http", "ws") + "/live"
        opening = connect(address, **{"origin": url, "proxy": None, **options})
        self._exits = ExitStack()
        self.socket = self._exits.enter_context(opening)
        self.seq = 0
        self.nonce = ""
        try:
            self.nonce = self.hear()["nonce"]
        except websockets.ConnectionClosed:
            self.close()
            raise

    def send(self, text):
        self.socket.send(text)

    def prove(self, key):
        self.send(json.dumps({"kind": "hello", "proof": challenge_response(key, self.nonce)}))
        return self

    def say(self, kind, seen=0, **fields):
        self.seq += 1
        self.send(json.dumps({"kind": kind, "seq": self.seq, "seen": seen, **fields}))

    def hear(self):
        return json.loads(self.socket.recv(timeout=10))

    def hear_of(self, kind):
        """Return the next message of a kind."""
        while True:
            message = self.hear()
            if message["kind"] == kind:
                return message

    def closing_code(self):
        """Return the code with which the server ends it."""
        try:
            while True:
                self.hear()
        except websockets.ConnectionClosed as closed:
            return closed.rcvd.code if closed.rcvd else 1006

    def close(self):
        self._exits.close()
