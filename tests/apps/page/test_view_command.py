"""The command that serves the page: its output, refusals and end."""

import hashlib
import os
import re
import signal
import ssl
import subprocess
import sys

import httpx
import pytest

from ikservo.apps.page.arm_choices import find_choices
from ikservo.apps.page.panels.servo_bench import ServoBench
from ikservo.hardware.serial_ports import SerialAdapter
from ikservo.remedies import install_command


def started(*options):
    """Return the process of the view, with its output unread."""
    words = [sys.executable, "-c", "from ikservo.cli import console; console()", "view",
             "--no-open", "--http-port", "0", *options]  # fmt: skip
    return subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def served(*options):
    return started("--port", "sim", *options)


@pytest.mark.full
def test_view_command_serves_page_until_ctrl_c():
    serving = served()
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


def test_view_command_without_packages_says_what_to_install(run_cli, monkeypatch):
    monkeypatch.setattr("ikservo.apps.page.view_command.find_spec", lambda name: None)
    result = run_cli("view --port sim")
    assert result.code == 2
    assert install_command("view") in result.err


@pytest.mark.parametrize("address", ["localhost", "example.com", "1.2.3", "127.0.0.1:80"])
def test_invalid_listen_address_is_refused(run_cli, address):
    result = run_cli(f"view --port sim --listen {address}")
    assert result.code == 2
    assert "IP address" in result.err


def test_listen_address_of_other_machine_is_refused(run_cli):
    result = run_cli("view --port sim --listen 192.0.2.1 --http-port 0")
    assert result.code == 3
    assert "cannot be served" in result.err


@pytest.mark.parametrize("http", ["-1", "65536", "x"])
def test_invalid_http_port_is_refused(run_cli, http):
    assert run_cli(f"view --port sim --http-port {http}").code == 2


def test_port_without_arm_is_listed_on_page():
    choices = find_choices(port="/dev/ttyNOTHERE")
    assert choices.choose("so101", "/dev/ttyNOTHERE").port == "/dev/ttyNOTHERE"
    assert "/dev/ttyNOTHERE" not in find_choices().ports


@pytest.mark.full
@pytest.mark.sample(1)
@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ((), "No arm is open. Choose one on the page; this does not move it."),
        (("--camera", "77"), "this does not move it. The page then shows the camera's picture."),
        (("--camera", "77"), "There is no picture from camera 77 now: the page shows it once"),
        (("so101=sim", "koch=/dev/ttyNOTHERE"), "koch: Cannot open port /dev/ttyNOTHERE"),
    ],
)
def test_view_serves_page_without_arm_or_with_failed_arm(options, expected):
    serving = started(*options)
    try:
        url = serving.stdout.readline().strip()
        assert "<canvas" in httpx.get(url).text
        serving.send_signal(signal.SIGINT)
        _, reported = serving.communicate(timeout=30)
    finally:
        serving.kill()
        serving.communicate()
    assert serving.returncode == 0
    assert expected in reported


@pytest.mark.parametrize(
    ("line", "code", "expected"),
    [
        ("view so101 koch --port /dev/ttyNOTHERE", 2, "one port for 2 arms"),
        ("view so101=sim --arm koch", 2, "Both --arm koch and so101=sim are given"),
        ("view so101=sim kock=sim", 2, "koch"),
        ("view so101=/dev/ttyNOTHERE koch=/dev/ttyNOR --http-port 0", 3, "/dev/ttyNOTHERE"),
    ],
)
def test_contradictory_arm_options_of_view_are_refused(run_cli, line, code, expected):
    result = run_cli(line)
    assert (result.code, result.out) == (code, "")
    assert expected in result.err


@pytest.mark.parametrize(
    ("arms", "scene", "sentence"),
    [
        (
            "so101 koch",
            '[[sphere]]\nname = "a"\ncentre_m = [0, 1, 0]\nradius_m = 0.1',
            "not 2",
        ),
        ("so101", "[[sphere]]\nradius = 1", "is not a known key"),
        ("so101", None, "does not exist"),
        ("so101", '[[arm]]\nname = "koch"\nat_m = [0.4, 0, 0]', "koch, which is not being opened"),
        ("koch", '[[arm]]\nname = "koch"\nat_m = [0.4, 0, 0]', "not 0"),
        (
            "so101 koch px150",
            '[[arm]]\nname = "koch"\nat_m = [0.4, 0, 0]',
            "one arm that it does not name, not 2",
        ),
        (
            "so101 koch",
            '[[arm]]\nname = "koch"\nat_m = [0, 0, 0]',
            "0.03 to 10 m from the base of this arm",
        ),
    ],
)
def test_invalid_scene_is_refused_by_view(run_cli, tmp_path, arms, scene, sentence):
    path = tmp_path / "scene.toml"
    if scene is not None:
        path.write_text(scene)
    done = run_cli(f"view {arms} --port sim --no-open --scene {path}")
    assert (done.code, sentence in done.err) == (2, True)
    assert "/dev/tty" not in done.err


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        ("--port sim --task wave", "Add --record"),
        ("so101=sim koch=sim --task wave --record {}/set", "needs exactly one arm, not 2"),
        ("--task wave --record {}/set", "needs exactly one arm, not 0"),
        ("--port sim --task wave --record {}", "is not a data set"),
        ("--port sim --task wave --record {}/mine.txt", "is a file"),
        ("--port sim --record {}/set", "have no task"),
    ],
)
def test_view_refuses_unusable_data_set_before_serving(run_cli, tmp_path, line, sentence):
    (tmp_path / "mine.txt").write_text("mine")
    done = run_cli(f"view --no-open {line.format(tmp_path)}")
    assert done.code == 2
    assert sentence in " ".join(done.err.split())
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_commands_other_than_view_do_not_import_server():
    script = (
        "import sys; from ikservo.cli import main; main(['arms']);"
        "sys.exit('starlette' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", script], env=os.environ, check=False,
                          capture_output=True).returncode == 0  # fmt: skip


QR_CODES = ("to watch only", "to control the arm")


@pytest.mark.full
def test_control_address_is_printed_before_watch_address():
    serving = served()
    try:
        url = serving.stdout.readline().strip()
        first, second, watch = (serving.stderr.readline().strip() for _ in range(3))
    finally:
        serving.kill()
        serving.communicate()
    assert (first, second) == ("To control the arm:", "To watch only:")
    assert watch.partition("#token=")[0] == url.partition("#token=")[0]
    assert watch != url


@pytest.mark.full
def test_tls_view_prints_fingerprint_and_qr_codes(own_address):
    serving = served("--listen", own_address)
    try:
        url = serving.stdout.readline().strip()
        port = int(url.partition("/#")[0].rpartition(":")[2])
        der = ssl.PEM_cert_to_DER_cert(ssl.get_server_certificate((own_address, port)))
        serving.send_signal(signal.SIGINT)
        _, reported = serving.communicate(timeout=30)
    finally:
        serving.kill()
        serving.communicate()
    assert url.startswith(f"https://{own_address}:")
    lines = reported.splitlines()
    assert hashlib.sha256(der).digest().hex(":").upper() in lines
    watch, control = (lines.index(f"QR code {who}:") for who in QR_CODES)
    assert watch < control
    for label in (watch, control):
        assert sum("█" in line or "▄" in line for line in lines[label + 1 : label + 16]) == 15


def test_damaged_certificate_is_reported_before_serving(
    run_cli, own_address, tmp_path, monkeypatch
):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    (tmp_path / "view-certificate.pem").write_text("broken")
    (tmp_path / "view-certificate.pem").chmod(0o600)
    result = run_cli(f"view --port sim --listen {own_address} --http-port 0")
    assert result.code == 2
    assert "cannot be used: it holds no certificate" in result.err
    assert "Delete the file" in result.err


def test_view_without_tls_libraries_says_what_is_missing(run_cli, monkeypatch):
    monkeypatch.setattr(
        "ikservo.apps.page.view_command.find_spec", lambda name: name != "segno" or None
    )
    result = run_cli("view --port sim --listen 192.0.2.1 --http-port 0")
    assert result.code == 2
    assert "needs segno" in result.err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("--port sim", "No arm given for the simulator"),
        ("so101 --port sim", "does not open arms"),
        ("--port sim --arm so101 --camera 0", "does not open arms"),
        ("--port sim --arm so101 --camera-name left", "does not open arms"),
        ("--port sim --camera-name ../a", "--camera-name is '../a'"),
        ("--port sim:so100 --arm so101", "is not a port"),
        ("--port sim --arm so999", "so999"),
    ],
)
def test_invalid_servo_view_options_are_refused(run_cli, monkeypatch, words, said):
    monkeypatch.setattr("ikservo.apps.page.page_app.serve", lambda *_: None)
    result = run_cli(f"view --servos --no-open --http-port 0 {words}")
    assert (result.code, result.out) == (2, "")
    assert said in result.err


@pytest.mark.parametrize(
    ("devices", "code"), [((), 3), (("/dev/a",), 0), (("/dev/a", "/dev/b"), 3)]
)
def test_servo_view_uses_the_only_connected_port(run_cli, monkeypatch, devices, code):
    adapters = [SerialAdapter(device, "", 1, 2, "") for device in devices]
    monkeypatch.setattr("ikservo.hardware.port_choice.list_adapters", lambda: adapters)
    monkeypatch.setattr("ikservo.apps.page.page_app.serve", lambda *_: None)
    result = run_cli("view --servos --no-open --http-port 0")
    assert result.code == code, result.err


def test_servo_view_opens_page_although_port_is_missing(run_cli, monkeypatch):
    monkeypatch.setattr("ikservo.apps.page.page_app.serve", lambda *_: None)
    result = run_cli("view --servos --no-open --http-port 0 --port /dev/ttyNONE")
    assert result.code == 0
    assert result.out.startswith("http://127.0.0.1:")


@pytest.mark.full
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_signal_closes_servo_view_cleanly(run_cli, monkeypatch, number):
    closed, close = [], ServoBench.close
    monkeypatch.setattr("ikservo.apps.page.page_app.serve", lambda *_: signal.raise_signal(number))
    monkeypatch.setattr(ServoBench, "close", lambda bench: closed.append(close(bench)))
    before = signal.signal(number, signal.SIG_IGN)  # what would end the tests, too
    try:
        result = run_cli("view --servos --no-open --http-port 0 --port sim --arm so101")
    finally:
        signal.signal(number, before)
    assert (closed, result.code) == ([None], 130)
