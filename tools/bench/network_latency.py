"""Measure the delay of an operator's goals over network and port, and the states of eight arms.

Run ``python tools/bench/network_latency.py``; results belong in docs/benchmarks.md. Servos, server
and operator are processes of their own: the servos on a pseudo-terminal, Zenoh on loopback. A goal
has arrived when the first control cycle that obeys it has sent its goals to the bus. For eight
arms at a time the servos are simulated in the servers.
"""

from __future__ import annotations

import argparse
import itertools
import math
import multiprocessing
import socket
import sys
import time
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from multiprocessing.connection import Connection as Pipe
from multiprocessing.context import SpawnProcess
from statistics import median
from typing import Any, cast

import jitter

import ikservo
from ikservo.apps.remote import key_expressions as keys
from ikservo.apps.remote.address import ArmAddress, Endpoint
from ikservo.apps.remote.arm_server import ArmServer
from ikservo.apps.remote.setpoint_inbox import SetpointInbox
from ikservo.apps.remote.wire_messages import MAX_REQUEST_BYTES, Announcement, Setpoint, decode
from ikservo.apps.remote.zenoh_session import open_client, open_server
from ikservo.arm import Arm
from ikservo.arm.opening import open_own_arm
from ikservo.arm.target_tracking import CartesianOrJointTarget, TargetTracker
from ikservo.kinematics.arrays import Vector

JOINT, SWING_RAD, PERIOD_S = "shoulder_pan", 0.3, 4.0
ASKED_MEDIAN_MS, ASKED_P99_MS = 5.0, 20.0  # requested bounds of the delay added to the local path
ARMS, STATES_HZ = 8, 50.0
_SPAWN = multiprocessing.get_context("spawn")

Times = dict[float, float]
"""The time at which each goal of ``JOINT`` [rad] was sent or had arrived [s, machine's clock]."""


def note_received() -> Times:
    """Return a dictionary that collects the times at which goals reach the server's process."""
    received: Times = {}
    put = SetpointInbox.put

    def note(self: SetpointInbox, setpoint: Setpoint) -> None:
        put(self, setpoint)
        if setpoint.positions:
            received[setpoint.positions[JOINT]] = time.monotonic()

    SetpointInbox.put = note
    return received


def note_arrivals(arm: Arm) -> Times:
    """Return a dictionary that collects the times at which goals are first obeyed on the bus."""
    arrived: Times = {}
    servos, taken = arm.context.servos, math.nan
    solve, send = TargetTracker.solve_joints, servos.send_goals

    def take(
        self: TargetTracker, target: CartesianOrJointTarget, last: Vector
    ) -> tuple[Vector, bool]:
        nonlocal taken
        taken = cast("dict[str, float]", target)[JOINT]
        return solve(self, target, last)

    def command(positions: Vector, now_s: float, reference: Vector | None = None) -> bool:
        sent = send(positions, now_s, reference)
        arrived.setdefault(taken, time.monotonic())
        return sent

    TargetTracker.solve_joints = take
    servos.send_goals = command
    return arrived


def stream_goals(arm: ikservo.OpenArm, seconds: float, rate_hz: float) -> Times:
    """Stream a swing of one joint; return when each goal was sent."""
    sent: Times = {}
    start_rad, start_s = arm.where()[JOINT].position_rad, time.monotonic()
    with arm.stream(speed="fast", rate_hz=rate_hz) as stream:
        while (now_s := time.monotonic()) < start_s + seconds:
            goal = start_rad + SWING_RAD * math.sin(math.tau * (now_s - start_s) / PERIOD_S)
            sent[goal] = time.monotonic()
            stream.send({JOINT: goal})
    return sent


def serve(port: str, name: str, tcp_port: int, rate_hz: float, pipe: Pipe) -> None:
    """Serve an arm until a message comes from the pipe; then send the arrival times."""
    endpoint = Endpoint("tcp", "127.0.0.1", tcp_port)
    with (
        open_server(endpoint, None, None) as session,
        open_own_arm(ikservo.load_model("so101"), port) as arm,
        ArmServer(session, arm, name, rate_hz),
    ):
        arm.pose("home")
        received, arrived = note_received(), note_arrivals(arm)
        pipe.send("served")
        pipe.recv()
        pipe.send((received, arrived))


def operate(address: str, seconds: float, rate_hz: float, pipe: Pipe) -> None:
    """Stream goals to a served arm; send when each was sent."""
    with ikservo.open_arm("so101", port=address) as arm:
        pipe.send(stream_goals(arm, seconds, rate_hz))


def watch(addresses: Sequence[tuple[str, int]], seconds: float, pipe: Pipe) -> None:
    """Subscribe to the states of some arms; send what was received and when [s]."""
    received: list[tuple[str, float, float]] = []

    def receive(sample: Any) -> None:  # noqa: ANN401
        at_s = time.monotonic()
        news = decode(Announcement, sample.payload.to_bytes(), MAX_REQUEST_BYTES)
        received.append((str(sample.key_expr), at_s, news.sent_s))

    endpoints = [Endpoint("tcp", "127.0.0.1", port) for _, port in addresses]
    with (
        open_client(endpoints, None) as session,
        session.declare_subscriber(keys.news("*", "state"), receive),
    ):
        time.sleep(seconds)
    pipe.send(received)


@contextmanager
def process(function: Any, *arguments: Any) -> Generator[Pipe]:  # noqa: ANN401
    """Run a function with a pipe in a process of its own; yield this end of the pipe."""
    here, there = _SPAWN.Pipe()
    child: SpawnProcess = _SPAWN.Process(target=function, args=(*arguments, there))
    child.start()
    try:
        yield here
    finally:
        child.join(20.0)
        child.kill()


def free_port() -> int:
    """Return a TCP port at which nothing listens."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def delays_ms(sent: Times, arrived: Times) -> list[float]:
    """Return the delay of each goal, except goals that a later one replaced in time."""
    return [1000.0 * (arrived[goal] - at_s) for goal, at_s in sent.items() if goal in arrived]


def on_the_port(seconds: float, rate_hz: float) -> list[float]:
    """Return the delays [ms] of the goals of a program on the machine of the arm."""
    with (
        jitter.served("so101") as (port, _),
        open_own_arm(ikservo.load_model("so101"), port) as arm,
    ):
        arm.pose("home")
        arrived = note_arrivals(arm)
        sent = stream_goals(arm, seconds, rate_hz)
    return delays_ms(sent, arrived)


def over_the_network(seconds: float, rate_hz: float) -> tuple[list[float], list[float]]:
    """Return the delays [ms] of the goals of an operator: to the server, and to the servos."""
    tcp_port = free_port()
    address = str(ArmAddress("desk", Endpoint("tcp", "127.0.0.1", tcp_port)))
    with (
        jitter.served("so101") as (port, _),
        process(serve, port, "desk", tcp_port, 50.0) as server,
    ):
        server.recv()
        with process(operate, address, seconds, rate_hz) as operator:
            sent: Times = operator.recv()
        server.send("end")
        received, arrived = server.recv()
    return delays_ms(sent, received), delays_ms(sent, arrived)


def many_arms(seconds: float) -> tuple[list[float], list[float], list[tuple[str, float, float]]]:
    """Return the delays of goals to eight arms [ms], as for one, and the received states."""
    ports = [free_port() for _ in range(ARMS)]
    with _nested(
        [(serve, "sim:?pose=home", f"arm-{k}", port, STATES_HZ) for k, port in enumerate(ports)]
    ) as servers:
        for server in servers:
            server.recv()
        names = [(f"arm-{k}", port) for k, port in enumerate(ports)]
        addresses = [str(ArmAddress(n, Endpoint("tcp", "127.0.0.1", p))) for n, p in names]
        jobs = [(operate, address, seconds, STATES_HZ) for address in addresses]
        with process(watch, names, seconds) as watcher, _nested(jobs) as operators:
            sent = [operator.recv() for operator in operators]
            states = watcher.recv()
        for server in servers:
            server.send("end")
        ends = [server.recv() for server in servers]
    to_servers = [d for one, end in zip(sent, ends, strict=True) for d in delays_ms(one, end[0])]
    to_servos = [d for one, end in zip(sent, ends, strict=True) for d in delays_ms(one, end[1])]
    return to_servers, to_servos, states


@contextmanager
def _nested(jobs: Sequence[tuple[Any, ...]]) -> Generator[list[Pipe]]:
    """Run several processes; yield the pipes to them."""
    if not jobs:
        yield []
        return
    with process(*jobs[0]) as first, _nested(jobs[1:]) as others:
        yield [first, *others]


def part(values: Sequence[float], share: float) -> float:
    """Return the value below which a fraction of the values lies."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))]


def print_delays(name: str, delays: Sequence[float]) -> None:
    """Print a row of the table of delays."""
    print(f"| {name} | {len(delays)} | {median(delays):.1f} ms | {part(delays, 0.99):.1f} ms "
          f"| {max(delays):.1f} ms |", flush=True)  # fmt: skip


def print_states(received: Sequence[tuple[str, float, float]]) -> None:
    """Print ages and periods of the states of all arms."""
    arrivals: dict[str, list[float]] = {}
    for key, at_s, _ in received:
        arrivals.setdefault(key, []).append(at_s)
    ages = [1000.0 * (at_s - sent_s) for _, at_s, sent_s in received]
    late = [
        1000.0 * (later - earlier - 1.0 / STATES_HZ)
        for times in arrivals.values()
        for earlier, later in itertools.pairwise(times)
    ]
    seconds = max(max(times) - min(times) for times in arrivals.values())
    print(f"states: {len(received)} of {len(arrivals)} arms, "
          f"{len(received) / len(arrivals) / seconds:.1f} a second of each; "
          f"age at arrival median {median(ages):.1f} ms, p99 {part(ages, 0.99):.1f} ms; "
          f"after the one before {1000.0 / STATES_HZ:.0f} ms and p99 {part(late, 0.99):.1f} ms "
          f"more, at most {max(late):.1f} ms")  # fmt: skip


def run() -> int:
    """Measure and print the tables."""
    parser = argparse.ArgumentParser(description="Delay of goals and states over the network")
    parser.add_argument("--seconds", type=float, default=30.0)
    seconds = parser.parse_args().seconds
    print("| goals | received | median | p99 | longest |\n|---|---:|---:|---:|---:|", flush=True)
    beside = on_the_port(seconds, 100.0)
    print_delays("of a program on the port, to the servos", beside)
    to_server, to_servos = over_the_network(seconds, 100.0)
    print_delays("of an operator, to the process beside the arm", to_server)
    print_delays("of an operator, to the servos", to_servos)
    to_servers, to_many, states = many_arms(seconds)
    print_delays(f"{STATES_HZ:g} Hz to each of {ARMS} arms, to the processes", to_servers)
    print_delays(f"{STATES_HZ:g} Hz to each of {ARMS} arms, to the servos", to_many)
    print_states(states)
    more_ms = median(to_servos) - median(beside)
    print(f"the network adds {more_ms:.1f} ms to the median, "
          f"{part(to_servos, 0.99) - part(beside, 0.99):.1f} ms to the p99")  # fmt: skip
    kept = median(to_server) <= ASKED_MEDIAN_MS and part(to_server, 0.99) <= ASKED_P99_MS
    return 0 if kept and more_ms <= ASKED_MEDIAN_MS else 1


if __name__ == "__main__":
    sys.exit(run())
