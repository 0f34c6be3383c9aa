"""Arms that ``ikservo sim`` serves in real time, and LeRobot's commands for them."""

import json
import os
import socket
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np

BIN = Path(sys.executable).parent


class ServedArm:
    """A simulated arm on a pseudo-terminal, with a socket that reports its true position."""

    def __init__(self, folder, name):
        self.port, self.control = folder / f"{name}.port", folder / f"{name}.control"

    def ask(self, **request):
        with socket.socket(socket.AF_UNIX) as line:
            line.connect(str(self.control))
            line.sendall(json.dumps(request).encode() + b"\n")
            with line.makefile() as answer:
                return json.loads(answer.readline())

    def tip_m(self):
        return np.array(self.ask(do="state")["tip_m"])

    def servos(self):
        return self.ask(do="state")["servos"]

    def ticks(self):
        return np.array([servo["position"] for servo in self.servos()])


@contextmanager
def served(folder, name, *options, model="so101"):
    arm = ServedArm(folder, name)
    words = ["sim", model, "--link", arm.port, "--control", arm.control, *options]
    server = subprocess.Popen(
        [BIN / "ikservo", *map(str, words)], stdout=subprocess.PIPE, text=True,
        start_new_session=True,
    )  # fmt: skip
    server.stdout.readline()
    try:
        yield arm
    finally:
        server.terminate()
        server.wait()


def start(folder, command, *options, **environment):
    """Start one of LeRobot's commands; its output goes to a file."""
    env = {**os.environ, "HF_HUB_OFFLINE": "1", "HF_LEROBOT_HOME": str(folder / "lerobot"),
           "HF_LEROBOT_CALIBRATION": str(folder / "calibration"),
           "IKSERVO_HOME": str(folder / "home"), **environment}  # fmt: skip
    log = (folder / f"{command}.log").open("a")
    words = [BIN / command, *options]
    return subprocess.Popen(list(map(str, words)), stdout=log, stderr=log, env=env,
                            stdin=subprocess.DEVNULL)  # fmt: skip


def run(folder, command, *options, timeout_s=240, **environment):
    process = start(folder, command, *options, **environment)
    code = process.wait(timeout_s)
    assert code == 0, (folder / f"{command}.log").read_text()[-3000:]
    return (folder / f"{command}.log").read_text()


class Watch:
    """Records the tip of an arm during the block in ``path_m`` (k, 3)."""

    def __init__(self, arm, period_s=0.03):
        self._arm, self._period_s, self._ending = arm, period_s, threading.Event()
        self.path_m = []

    def __enter__(self):
        self._thread = threading.Thread(target=self._look)
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._ending.set()
        self._thread.join()
        self.path_m = np.array(self.path_m)

    def _look(self):
        while not self._ending.wait(self._period_s):
            self.path_m.append(self._arm.tip_m())


def distance_m(points_m, path_m):
    """Return the distance (k,) of points from a path of straight segments."""
    begin, way = path_m[:-1], np.diff(path_m, axis=0)
    square = np.maximum((way**2).sum(axis=1), 1e-12)
    share = np.clip(((points_m[:, None] - begin) * way).sum(axis=2) / square, 0.0, 1.0)
    nearest = begin + share[:, :, None] * way
    return np.linalg.norm(points_m[:, None] - nearest, axis=2).min(axis=1)


def await_until(condition, timeout_s=60.0):
    end_s = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.02)
