"""The simulator as a process: arms on pseudo-terminals, moved through its control socket."""

import contextlib
import json
import math
import socket
import subprocess
import sys
import time

IKSERVO = [sys.executable, "-c", "from ikservo.cli import console; console()"]


class SimulatorProcess:
    """`ikservo sim` with an arm or single servos.

    Attributes:
        port: The path for ``--port``.
    """

    def __init__(self, folder, *words):
        self.port, self._control = folder / "port", folder / "control"
        argv = [*IKSERVO, "sim", *map(str, words), "--link", self.port, "--control", self._control]
        self._process = subprocess.Popen(list(map(str, argv)), stdout=subprocess.PIPE, text=True)
        assert self._process.stdout.readline().strip()

    def send_command(self, what, **more):
        """Send a command to the simulator, see docs/servosim.md; return its response."""
        with socket.socket(socket.AF_UNIX) as client:
            client.connect(str(self._control))
            client.sendall(json.dumps({"do": what, **more}).encode() + b"\n")
            response = json.loads(client.makefile().readline())
        assert response["ok"], response
        return response

    def joints_deg(self):
        """Return the true position of every revolute joint [degrees]."""
        joints = self.send_command("state")["joints"]
        return {n: joint["position_deg"] for n, joint in joints.items() if "position_deg" in joint}

    def torque(self):
        """Return whether each servo holds, in the order of the bus."""
        return [servo["torque"] for servo in self.send_command("state")["servos"]]

    def move_joint(self, joint, deg, force=20.0):
        """Move a joint by hand and wait until it is there."""
        self.send_command("hand", joint=joint, deg=deg, force=force)
        until_s = time.monotonic() + 30.0
        while abs(self.joints_deg()[joint] - deg) > 2.0 and time.monotonic() < until_s:
            time.sleep(0.05)

    def move_joints(self, joints_deg, force=20.0, speed=3.0):
        """Move several joints by hand at once and wait until they are there."""
        for joint, deg in joints_deg.items():
            self.send_command("hand", joint=joint, deg=deg, force=force, speed=speed)
        self._wait(lambda: all(abs(self.joints_deg()[j] - d) < 1.0 for j, d in joints_deg.items()))

    def move_tip(self, point_m, speed=3.0):
        """Move the tip by hand to a point and wait until it is there."""
        self.send_command("hand", tip_m=list(point_m), speed=speed)
        self._wait(lambda: math.dist(self.send_command("state")["tip_m"], point_m) < 0.001)

    def _wait(self, done, within_s=30.0):
        until_s = time.monotonic() + within_s
        while not done():
            assert time.monotonic() < until_s, f"the arm does not get there: {self.joints_deg()}"
            time.sleep(0.05)

    def release(self, joint):
        self.send_command("hand", joint=joint, release=True)

    def release_all(self):
        self.send_command("hand", release=True)

    def terminate(self):
        self._process.terminate()
        self._process.communicate()


@contextlib.contextmanager
def run_simulator(folder, *words):
    """Yield the running simulator of an arm or of single servos."""
    folder.mkdir(exist_ok=True)
    simulator = SimulatorProcess(folder, *words)
    try:
        yield simulator
    finally:
        simulator.terminate()
