"""A TCP proxy between two Zenoh sessions that fails on request.

Zenoh writes messages to TCP in frames: two bytes of length, little endian, then the content.
"""

import contextlib
import queue
import random
import socket
import threading
import time

CUTS = ("hang up", "fall silent", "half open", "delay", "garble")
"""After these the operator is not heard any more; "half open" forwards the answers to it."""

FRAME_FAULTS = ("drop", "duplicate", "reorder")
"""What is done to single frames, of both directions."""


class CuttingProxy:
    """Forwards connections to a port of this machine.

    Attributes:
        port: The port on which the server listens.
    """

    def __init__(self, target_port, delay_s=0.6, seed=0):
        self._target, self._delay_s, self._dice = target_port, delay_s, random.Random(seed)
        self._how, self._sockets = "forward", []  # of every connection, hung up or not
        self._lock = threading.Lock()  # of the list of sockets
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port = self._listening.getsockname()[1]
        self._accepting = threading.Thread(target=self._accept, daemon=True)
        self._accepting.start()

    def cut(self, how):
        """Fail on every connection in one of the ways in ``CUTS`` or ``FRAME_FAULTS``."""
        self._how = how
        if how == "hang up":
            self._hang_up()

    def restore(self):
        """Forward again: delayed messages arrive, silent connections continue."""
        self._how = "forward"

    def close(self):
        """Stop listening, and close all accepted connections."""
        with contextlib.suppress(OSError):
            self._listening.shutdown(socket.SHUT_RDWR)  # wakes the thread that accepts
        self._listening.close()
        self._accepting.join(5.0)
        self._hang_up()

    def _hang_up(self):
        with self._lock:
            for each in self._sockets:
                with contextlib.suppress(OSError):  # the other end was quicker
                    each.shutdown(socket.SHUT_RDWR)
                each.close()
            self._sockets = []

    def _accept(self):
        """Accept and forward connections until the proxy is closed."""
        while True:
            try:
                near, _ = self._listening.accept()
            except OSError:  # closed
                return
            with self._lock:
                self._sockets.append(near)
            with contextlib.suppress(OSError):  # the server is gone, or one end hung up
                self._forward(near)

    def _forward(self, near):
        """Start to forward a connection; if it is closed meanwhile, its threads end."""
        far = socket.create_connection(("127.0.0.1", self._target))
        with self._lock:
            self._sockets.append(far)
        for one in (near, far):
            one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for one, other in ((near, far), (far, near)):
            frames = queue.Queue()
            read = (one, frames, one is near)
            threading.Thread(target=self._read, args=read, daemon=True).start()
            threading.Thread(target=self._write, args=(other, frames), daemon=True).start()

    def _read(self, source, frames, from_client):
        data, held = b"", []
        with contextlib.suppress(OSError):
            while more := source.recv(65536):
                data += more
                while len(data) >= 2 and len(data) >= (
                    end := 2 + int.from_bytes(data[:2], "little")
                ):
                    for frame in self._passed_on(data[:end], held, from_client):
                        frames.put((time.monotonic(), frame))
                    data = data[end:]
        frames.put((0.0, b""))

    def _passed_on(self, frame, held, from_client):
        """Return the frames to pass on: none, one or several, with those held back before."""
        match self._how:
            case "drop":
                return [frame] if self._dice.random() < 0.5 else []
            case "half open":
                return [] if from_client else [frame]
            case "duplicate":
                return [frame, frame]
            case "reorder" if not held:
                held.append(frame)
                return []
        later, held[:] = list(held), []
        return [frame, *later]

    def _write(self, sink, frames):
        with contextlib.suppress(OSError):
            while (frame := frames.get())[1]:
                since_s, data = frame
                if self._how == "garble":
                    data = bytes(byte ^ 0x5A for byte in data)
                while self._how == "fall silent" or (
                    self._how == "delay" and time.monotonic() < since_s + self._delay_s
                ):
                    time.sleep(0.002)
                sink.sendall(data)
        with contextlib.suppress(OSError):
            sink.shutdown(socket.SHUT_RDWR)
