"""``ikservo stop`` answers before the modules of the other commands could be loaded."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from ikservo.arm.control_server import serve
from ikservo.arm.result_json import encode_value
from ikservo.cli.quick_stop import _name_of
from ikservo.model import load_model
from ikservo.serving.control_client import ControlCommand, StopResult

ARM_FILE = str(load_model("so101").path)
HEAVY = {"numpy", "typer", "click", "pydantic", "rich", "serial", "zenoh", "importlib.metadata"}
STOP_AND_LIST_MODULES = """
import sys
from ikservo.cli import main
code = main(["stop", "--json", *sys.argv[1:]])
print(*sys.modules)
raise SystemExit(code)
"""


@pytest.fixture
def device(tmp_path, monkeypatch):
    """Return the port of an arm that another program, this one, has open."""
    for name in ("IKSERVO_ARM", "IKSERVO_PORT", "IKSERVO_FLEET"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    device = str(tmp_path / "ttyACM0")
    stopped = StopResult("so101", device, True, ("gripper",), (), ())

    def answer(request):
        who = {"arm": "so101", "port": device}
        return who if request.do is ControlCommand.WHO else encode_value(stopped)

    server = serve(device, answer)
    yield device
    server.close()


def run_stop(*args, code=0):
    done = subprocess.run(
        [sys.executable, "-c", STOP_AND_LIST_MODULES, *args],
        check=False,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert code in (None, done.returncode), done.stderr
    report, modules = done.stdout.splitlines()
    return json.loads(report), set(modules.split())


@pytest.mark.sample(2)
@pytest.mark.parametrize(
    "args",
    [
        (),
        ("--all",),
        ("--arm", "so101"),
        ("--arm", "so101", "--port={device}"),
        ("--arm", ARM_FILE),
        ("--arm", ARM_FILE, "--port={device}"),
        ("--arm", str(Path(ARM_FILE).parent), "--port={device}"),
    ],
)
def test_stop_command_does_not_load_large_modules(device, args):
    report, modules = run_stop(*(arg.format(device=device) for arg in args))
    assert [arm["held"] for arm in report["arms"]] == [["gripper"]]
    assert not HEAVY & modules


def test_stop_command_does_not_wait_for_pipe_as_arm_file(tmp_path):
    os.mkfifo(tmp_path / "arm.toml")
    assert _name_of(str(tmp_path)) == ""


def test_stop_command_with_arm_stops_only_that_arm(device, tmp_path):
    other = {"arm": "koch", "port": str(tmp_path / "ttyACM1")}
    asked = []

    def answer(request):
        asked.append(request.do)
        return other

    server = serve(other["port"], answer)
    try:
        report, _ = run_stop("--arm", "so101")
    finally:
        server.close()
    assert [arm["arm"] for arm in report["arms"]] == ["so101"]
    assert asked == ["who"]


@pytest.mark.full
def test_stop_command_also_stops_arms_of_network_plugins(device, tmp_path, monkeypatch):
    package = tmp_path / "site" / "other-1.0.dist-info"
    package.mkdir(parents=True)
    (package / "entry_points.txt").write_text("[ikservo.networks]\nother = other_network:NETWORK\n")
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: other\nVersion: 1.0\n")
    (package.parent / "other_network.py").write_text(
        "from ikservo.serving.control_client import StopAllResult, StopResult\n"
        "class NETWORK:\n"
        "    def stop_all_arms():\n"
        "        return StopAllResult((StopResult('far', 'other:1', True, ('a',), (), ()),))\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(package.parent))
    monkeypatch.setenv("IKSERVO_FLEET", "127.0.0.1:9")
    report, _ = run_stop(code=None)
    assert [arm["arm"] for arm in report["arms"]] == ["so101", "far"]
