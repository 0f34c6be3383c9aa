"""Processes of a campaign: the server beside the arm, and operators that can be killed."""

import json
import multiprocessing
import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from pathlib import Path

import ikservo
from ikservo.apps.remote import client_connection
from ikservo.apps.remote.address import Endpoint
from ikservo.apps.remote.arm_server import ArmServer
from ikservo.apps.remote.zenoh_session import open_server
from ikservo.errors import IkservoError, RefusedError
from tests.arm.simulated import line_of, servo_id, transport_of

JOINT, LOW_RAD, RAD_S = "wrist_roll", -1.4, 0.5
SPAWN = multiprocessing.get_context("spawn")


def address_of(port):
    return f"zenoh:desk@127.0.0.1:{port}"


@contextmanager
def process(function, *arguments):
    """Run a function with a pipe in a process of its own; yield both."""
    here, there = SPAWN.Pipe()
    child = SPAWN.Process(target=function, args=(*arguments, there))
    child.start()
    there.close()
    try:
        yield child, here
    finally:
        here.close()
        child.join(10.0)
        child.kill()


def serve(port, tcp_port, pipe, *, start=True):
    """Serve an arm at the start of the motion; answer questions until the pipe is closed."""
    endpoint = Endpoint("tcp", "127.0.0.1", tcp_port)
    with (
        open_server(endpoint, None, None) as session,
        ikservo.open_arm("so101", port=port) as arm,
        ArmServer(session, arm, "desk") as server,
    ):
        if start:
            arm.pose("home")
            arm.move_joints({JOINT: LOW_RAD}, speed="fast")
        log = written_goals(arm) if port.startswith("sim:") else []
        stops = requested_stops(arm)
        with suppress(EOFError):
            while True:
                answer(pipe, server, arm, log, stops)


def answer(pipe, server, arm, log, stops):
    match pipe.recv():
        case "log":
            pipe.send(list(log))
            log.clear()
        case "stops":
            pipe.send(stops)
        case _:
            moving = server.lease.moving is not None
            pipe.send((moving, arm.stopped_for, server.lease.dropped))


def requested_stops(arm):
    """Return a list that collects the time of every requested stop."""
    times, request = [], arm.request_stop

    def note(reason):
        request(reason)
        times.append(time.monotonic())

    arm.request_stop = note
    return times


def written_goals(arm):
    """Return a list that collects the time and one servo's goal register at every packet."""
    log, servo, transport = [], line_of(arm).servos[servo_id("so101", JOINT)], transport_of(arm)
    write = transport.write

    def note(data):
        count = write(data)
        log.append((time.monotonic(), servo.read("goal_position")))
        return count

    transport.write = note
    return log


def operators(pipe):
    """Run each requested function of this module in a forked process; answer with its id."""
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    client_connection._MAX_ROUND_TRIP_S = 60.0  # on a busy machine
    with suppress(EOFError):
        while True:
            name, arguments = pipe.recv()
            pid = os.fork()
            if pid:
                pipe.send(pid)
                continue
            try:
                globals()[name](*arguments)
            except IkservoError:  # the connection was cut
                pass
            finally:
                os._exit(0)


def stream_upwards(address):
    """Stream growing goals; after SIGUSR1 fall silent, then send every old goal again."""
    with ikservo.open_arm("so101", port=address) as arm, arm.stream(speed="fast") as stream:
        old, sending, asked = keep_messages(arm), arm._connection, []
        signal.signal(signal.SIGUSR1, lambda *_: asked.append(True))
        start_s = time.monotonic()
        while not asked:
            stream.send({JOINT: LOW_RAD + RAD_S * (time.monotonic() - start_s)})
            time.sleep(0.01)
        sending.send_setpoint = lambda **_: None
        time.sleep(0.6)
        for message in [*old, *old]:
            sending._setpoints.put(message)
        time.sleep(0.2)


def move_upwards(address):
    """Move far by one request, followed only by heartbeats."""
    with ikservo.open_arm("so101", port=address) as arm:
        arm.move_joints({JOINT: -LOW_RAD}, speed="slow")


def keep_messages(arm):
    """Return a list that collects every message that the operator's program publishes."""
    old, publisher = [], arm._connection._setpoints

    class Kept:
        def put(self, data):
            old.append(data)
            publisher.put(data)

    arm._connection._setpoints = Kept()
    return old


def try_to_move(address, path):
    """Record how many motions were refused."""
    refused = 0
    with ikservo.open_arm("so101", port=address) as arm:
        for move in (lambda: arm.move_joints({JOINT: 0.5}), arm.enable, lambda: arm.pose("home")):
            try:
                move()
            except RefusedError:
                refused += 1
    Path(path).write_text(json.dumps(refused))


def acknowledge_and_return(address, path):
    """Acknowledge, move to the start, and record whether the arm is there."""
    with ikservo.open_arm("so101", port=address) as arm:
        while True:
            with suppress(IkservoError):  # a busy machine did not reply in time: try again
                arm.acknowledge()
                there = arm.move_joints({JOINT: LOW_RAD}, speed="fast").reached
                break
    Path(path).write_text(json.dumps(there))


@contextmanager
def simulated_servos(folder):
    """Simulate an arm in a process of its own; yield its port and its control socket."""
    port, control = folder / "arm", folder / "control"
    words = ["sim", "so101", "--link", str(port), "--control", str(control), "--pose", "home"]
    code = "from ikservo.cli.entry_point import console; console()"
    with subprocess.Popen([sys.executable, "-c", code, *words], stdout=subprocess.PIPE) as servos:
        servos.stdout.readline()
        try:
            yield str(port), control
        finally:
            servos.terminate()


def read_goal(control):
    """Return the goal register of the joint's servo, without a driver."""
    with socket.socket(socket.AF_UNIX) as line:
        line.connect(str(control))
        line.sendall(b'{"do": "state"}\n')
        with line.makefile() as answer:
            servos = json.loads(answer.readline())["servos"]
    return next(servo["goal"] for servo in servos if servo["joint"] == JOINT)
