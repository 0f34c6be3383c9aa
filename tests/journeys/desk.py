"""What lies on an owner's desk: simulated arms behind pseudo-terminals, and hands to them."""

import contextlib
import json
import math
import socket
import subprocess
import sys
import time

IKSERVO = [sys.executable, "-c", "from ikservo.cli import console; console()"]


class Served:
    """A simulated arm, or loose servos, behind a port.

    Attributes:
        port: The path that follows ``--port``.
    """

    def __init__(self, folder, *words):
        self.port, self._control = folder / "port", folder / "control"
        argv = [*IKSERVO, "sim", *map(str, words), "--link", self.port, "--control", self._control]
        self._process = subprocess.Popen(list(map(str, argv)), stdout=subprocess.PIPE, text=True)
        assert self._process.stdout.readline().strip()

    def do(self, what, **more):
        """Do something to the servos, see docs/servosim.md; return what is answered."""
        with socket.socket(socket.AF_UNIX) as client:
            client.connect(str(self._control))
            client.sendall(json.dumps({"do": what, **more}).encode() + b"\n")
            answer = json.loads(client.makefile().readline())
        assert answer["ok"], answer
        return answer

    def joints_deg(self):
        """Return the true position of every turning joint [degrees]."""
        joints = self.do("state")["joints"]
        return {n: joint["position_deg"] for n, joint in joints.items() if "position_deg" in joint}

    def torque(self):
        """Return whether each servo holds, in the order of the bus."""
        return [servo["torque"] for servo in self.do("state")["servos"]]

    def lead(self, joint, deg, force=20.0):
        """Let a hand bring a joint somewhere, and wait until it is there."""
        self.do("hand", joint=joint, deg=deg, force=force)
        until_s = time.monotonic() + 30.0
        while abs(self.joints_deg()[joint] - deg) > 2.0 and time.monotonic() < until_s:
            time.sleep(0.05)

    def lead_all(self, joints_deg, force=20.0, speed=3.0):
        """Let hands bring joints somewhere, all at once, and wait until they stand there."""
        for joint, deg in joints_deg.items():
            self.do("hand", joint=joint, deg=deg, force=force, speed=speed)
        self._wait(lambda: all(abs(self.joints_deg()[j] - d) < 1.0 for j, d in joints_deg.items()))

    def lead_tip(self, point_m, speed=3.0):
        """Let hands bring the tip to a point, and wait until it stands there."""
        self.do("hand", tip_m=list(point_m), speed=speed)
        self._wait(lambda: math.dist(self.do("state")["tip_m"], point_m) < 0.001)

    def _wait(self, done, within_s=30.0):
        until_s = time.monotonic() + within_s
        while not done():
            assert time.monotonic() < until_s, f"the hand does not get there: {self.joints_deg()}"
            time.sleep(0.05)

    def let_go(self, joint):
        self.do("hand", joint=joint, release=True)

    def let_go_of_all(self):
        self.do("hand", release=True)

    def end(self):
        self._process.terminate()
        self._process.communicate()


@contextlib.contextmanager
def served(folder, *words):
    """Yield a simulated arm, or loose servos, behind a port."""
    folder.mkdir(exist_ok=True)
    desk = Served(folder, *words)
    try:
        yield desk
    finally:
        desk.end()
