"""The command that serves the page: what it prints, what it refuses, how it ends."""

import os
import re
import signal
import subprocess
import sys

import httpx
import pytest


def test_the_page_is_served_until_ctrl_c():
    words = [
        sys.executable,
        "-c",
        "from ikservo.cli import console; console()",
        "view",
        "--port",
        "sim",
        "--no-open",
        "--http-port",
        "0",
    ]
    serving = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        url = serving.stdout.readline().strip()
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+/#token=[\w-]{32}", url)
        assert "<canvas" in httpx.get(url).text
        serving.send_signal(signal.SIGINT)
        _, result = serving.communicate(timeout=30)
    finally:
        serving.kill()
        serving.communicate()
    assert (serving.returncode, result.splitlines()[-1]) == (
        0, "Torque stays as it was. Switch it off with: ikservo relax",
    )  # fmt: skip


def test_without_the_extra_the_command_says_what_to_install(run_cli, monkeypatch):
    monkeypatch.setattr("ikservo.cli.view.find_spec", lambda name: None)
    result = run_cli("view --port sim")
    assert result.code == 2
    assert "pip install 'ikservo[view]'" in result.err


@pytest.mark.parametrize("address", ["localhost", "example.com", "1.2.3", "127.0.0.1:80"])
def test_an_address_that_is_none_is_refused(run_cli, address):
    result = run_cli(f"view --port sim --listen {address}")
    assert result.code == 2
    assert "IP address" in result.err


def test_an_address_of_another_machine_is_refused(run_cli):
    result = run_cli("view --port sim --listen 192.0.2.1 --http-port 0")
    assert result.code == 3
    assert "cannot be served" in result.err


@pytest.mark.parametrize("http", ["-1", "65536", "x"])
def test_a_port_that_is_none_is_refused(run_cli, http):
    assert run_cli(f"view --port sim --http-port {http}").code == 2


def test_without_an_arm_a_real_port_asks_which(run_cli):
    result = run_cli("view --port /dev/ttyNOTHERE")
    assert result.code == 2
    assert "No arm given." in result.err


def test_no_other_command_loads_the_server():
    script = (
        "import sys; from ikservo.cli import main; main(['arms']);"
        "sys.exit('starlette' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", script], env=os.environ, check=False,
                          capture_output=True).returncode == 0  # fmt: skip
