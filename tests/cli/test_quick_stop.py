"""``ikservo stop`` answers before the modules of the other commands could be loaded."""

import json
import subprocess
import sys

import pytest

from ikservo.arm.control_server import serve

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
    """The port of an arm that another program, this one, has open."""
    for name in ("IKSERVO_ARM", "IKSERVO_PORT", "IKSERVO_FLEET"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    device = str(tmp_path / "ttyACM0")
    stopped = {"arm": "so101", "port": device, "moving": True, "held": ["gripper"], "limp": []}
    server = serve(device, lambda request: {**stopped, "silent": []})
    yield device
    server.close()


def run_stop(*args):
    done = subprocess.run(
        [sys.executable, "-c", STOP_AND_LIST_MODULES, *args],
        check=False,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    report, modules = done.stdout.splitlines()
    return json.loads(report), set(modules.split())


@pytest.mark.parametrize("args", [(), ("--all",), ("--arm", "so101", "--port={device}")])
def test_stop_loads_no_large_module_where_a_program_has_the_arm(device, args):
    report, modules = run_stop(*(arg.format(device=device) for arg in args))
    assert [arm["held"] for arm in report["arms"]] == [["gripper"]]
    assert not HEAVY & modules
