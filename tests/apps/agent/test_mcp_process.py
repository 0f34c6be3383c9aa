"""`ikservo mcp` as a process: its agent disconnects, stalls, or is killed; and over HTTPS."""

import contextlib
import json
import os
import re
import signal
import ssl
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request

import anyio
import pytest

pytest.importorskip("mcp")

from mcp.client.client import Client
from mcp.client.streamable_http import streamable_http_client

pytestmark = pytest.mark.full
FAR = {"move_joints": {"positions": {"shoulder_pan": 1.5}, "speed": "slow"}}


class McpProcess:
    """The server in a process of its own, and a client that writes the messages itself."""

    def __init__(self, home, *options, port="sim:?pose=home&paced=1"):
        words = ["-m", "ikservo", "mcp", "so101", "--port", port, *options]
        self.process = subprocess.Popen(
            [sys.executable, *words],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            env={**os.environ, "IKSERVO_HOME": str(home)},
        )  # fmt: skip
        self.home, self.number, self.answers_pings = home, 0, True
        self.answers, self.arrived = {}, threading.Condition()
        self.errors = []
        self.readers = [
            threading.Thread(target=read, daemon=True) for read in (self._read, self._read_errors)
        ]
        for each in self.readers:
            each.start()

    def end(self):
        self.process.kill()
        self.process.wait()
        for each in self.readers:
            each.join(10)
        for stream in (self.process.stdin, self.process.stdout, self.process.stderr):
            with contextlib.suppress(OSError):
                stream.close()

    def connect(self):
        self.ask("initialize", protocolVersion="2025-06-18", capabilities={},
                 clientInfo={"name": "test", "version": "1"})  # fmt: skip
        self.send({"method": "notifications/initialized"})

    def send(self, message):
        self.process.stdin.write(json.dumps({"jsonrpc": "2.0", **message}) + "\n")
        self.process.stdin.flush()

    def begin(self, method, **params):
        self.number += 1
        self.send({"id": self.number, "method": method, "params": params})
        return self.number

    def ask(self, method, **params):
        return self.wait_for(self.begin(method, **params))

    def wait_for(self, number, timeout_s=60):
        with self.arrived:
            assert self.arrived.wait_for(lambda: number in self.answers, timeout_s), self.errors
        return self.answers[number]

    def call(self, tool, **arguments):
        return self.ask("tools/call", name=tool, arguments=arguments)["result"]

    def begin_motion(self, *, answers_pings=True):
        hold = self.call("gripper", to="open")  # a limp arm sinks between plan and motion
        assert not hold["isError"], hold
        self.answers_pings = answers_pings
        plan = self.call("plan", motion=FAR)["structuredContent"]["plan_id"]
        number = self.begin("tools/call", name="execute", arguments={"plan_id": plan})
        time.sleep(1.5)
        return number

    def journal(self):
        (path,) = (self.home / "agent").glob("*.jsonl")
        return [json.loads(line) for line in path.read_text("utf-8").splitlines()]

    def _read(self):
        for line in self.process.stdout:
            message = json.loads(line)
            if message.get("method") == "ping":
                if self.answers_pings:
                    self.send({"id": message["id"], "result": {}})
            elif "id" in message:
                with self.arrived:
                    self.answers[message["id"]] = message
                    self.arrived.notify_all()

    def _read_errors(self):
        self.errors.extend(self.process.stderr)


@pytest.fixture
def start(tmp_path):
    """Return a function that starts the server; it is killed at the end."""
    started = []

    def begin(*options, connect=True, **more):
        started.append(McpProcess(tmp_path, *options, **more))
        if connect:
            started[0].connect()
        return started[0]

    yield begin
    for each in started:
        each.end()


@pytest.mark.parametrize("way", ["close", "SIGINT", "SIGTERM", "SIGHUP"])
def test_arm_brakes_when_the_agent_disconnects(start, way):
    server = start("--allow", "simulator")
    server.begin_motion()
    if way == "close":
        server.process.stdin.close()
    else:
        server.process.send_signal(getattr(signal, way))
    server.process.wait(20)
    failed = [each for each in server.journal() if each["event"] == "failed"]
    assert failed, (server.journal(), server.errors)
    assert not any("Traceback" in line for line in server.errors)
    assert not (server.home / "agent" / "consent.json").exists()


def test_arm_brakes_when_the_agent_stalls(start):
    server = start("--allow", "simulator")
    result = server.wait_for(server.begin_motion(answers_pings=False))["result"]
    assert result["isError"]
    assert "has not answered" in result["content"][0]["text"]


def test_agent_cannot_move_arm_by_default(start):
    server = start()
    plan = server.call("plan", motion=FAR)["structuredContent"]["plan_id"]
    assert "does not allow any motion" in server.call("execute", plan_id=plan)["content"][0]["text"]


def test_agent_server_survives_malformed_messages(start):
    server = start("--allow", "simulator")
    for line in ("", "{", "[1]", '{"jsonrpc": "2.0"}', "\x00", "é" * 100_000, "[" * 10_000):
        server.process.stdin.write(line + "\n")
    server.process.stdin.flush()
    assert server.call("where")["structuredContent"]["is_holding"] in (True, False)


def https_of(server):
    """Return the address and the key that a server has printed, and a context that trusts it."""
    for _ in range(600):
        found = re.search(r"(https://\S+)/mcp\n.*Bearer (\S+)", "".join(server.errors))
        if found:
            break
        time.sleep(0.1)
    trusting = ssl.create_default_context()
    trusting.check_hostname, trusting.verify_mode = False, ssl.CERT_NONE
    return *found.groups(), trusting


def test_mcp_over_https_requires_key_host_and_origin(start):
    server = start("--http-port", "0", port="sim:?pose=home", connect=False)
    address, key, trusting = https_of(server)

    def status(**headers):
        body = {"jsonrpc": "2.0", "id": 1, "method": "initialize", "params": {
            "protocolVersion": "2025-06-18", "capabilities": {},
            "clientInfo": {"name": "t", "version": "1"}}}  # fmt: skip
        sent = {"content-type": "application/json", "accept": "application/json, text/event-stream"}
        request = urllib.request.Request(
            f"{address}/mcp", json.dumps(body).encode(), {**sent, **headers}
        )
        try:
            with urllib.request.urlopen(request, timeout=20, context=trusting) as answer:
                return answer.status
        except urllib.error.HTTPError as error:
            return error.code

    bearer = {"authorization": f"Bearer {key}"}
    for _ in range(100):  # the server has printed its address before it listens
        try:
            assert status() == 401
            break
        except OSError:
            time.sleep(0.1)
    assert status(**bearer) == 200
    assert status(authorization="Bearer x") == 401
    assert status(**bearer, host="evil.example") == 421
    assert status(**bearer, origin="https://evil.example") == 403


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_arm_brakes_when_the_https_server_is_ended(start, number):
    httpx2 = pytest.importorskip("httpx2")
    server = start("--http-port", "0", "--allow", "simulator", connect=False)
    address, key, trusting = https_of(server)

    async def move():
        headers = {"authorization": f"Bearer {key}"}
        async with httpx2.AsyncClient(verify=trusting, headers=headers, timeout=60) as http:
            transport = streamable_http_client(f"{address}/mcp", http_client=http)
            async with Client(transport, mode="legacy") as client, anyio.create_task_group() as all:
                await client.call_tool("gripper", {"to": "open"})
                planned = await client.call_tool("plan", {"motion": FAR})
                plan = {"plan_id": planned.structured_content["plan_id"]}
                all.start_soon(client.call_tool, "execute", plan)
                await anyio.sleep(1.5)
                server.process.send_signal(number)
                await anyio.to_thread.run_sync(server.process.wait, 10)
                all.cancel_scope.cancel()

    with contextlib.suppress(Exception):  # the client misses its server
        anyio.run(move)
    assert server.process.poll() is not None, server.errors
    events = [each["event"] for each in server.journal()]
    assert events[-2:] == ["execute", "failed"] or events[-3:-1] == ["execute", "failed"], events
    assert not any("Traceback" in line for line in server.errors)
