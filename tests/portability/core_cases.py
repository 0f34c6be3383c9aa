"""Cases that must work on every system; each ends with a line that says so."""

import json
import sys
import urllib.request

import ikservo
from ikservo.apps.page.page_app import ViewApp
from ikservo.apps.page.served_arms import ArmAtPort
from ikservo.hardware.port_lock import acquire_lock
from tests.cli.fixtures_ports import run_arguments

COMMANDS = (
    "arms --json",
    "ports --json",
    "solve 0.25 0 0.15 --arm so101 --json",
    "move 0.25 0.05 0.15 --arm so101 --port sim --yes --json",
    "calibrate planar2 --port sim:?hand=calibrate --yes --json",
    "doctor --arm so101 --port sim --json",
    "relax --arm so101 --port sim --yes --json",
)


def solve():
    result = ikservo.solve(ikservo.load_model("so101").chain, ikservo.Target([0.25, 0.0, 0.15]))
    assert result.reached


def move():
    with ikservo.open_arm("so101", port="sim") as arm:
        assert arm.move_to([0.25, 0.0, 0.15]).reached


def view():
    page = ViewApp([ArmAtPort(ikservo.load_model("so101"), "sim")])
    with page as urls, page.serve_in_thread(), urllib.request.urlopen(urls.watch) as answer:
        assert b"<title>" in answer.read()


def lock():
    with acquire_lock("COM3"), acquire_lock("COM4"):
        pass


def sim():
    done = run_arguments(["sim", "so101"])
    assert (done.code, "add --port sim" in done.err) == (1, True), done.err


def command(line):
    done = run_arguments(line.split())
    assert done.code == 0, done.err
    assert json.loads(done.out)["schema"].startswith("ikservo/")


if __name__ == "__main__":
    for case in (solve, move, view, lock, sim):
        case()
        sys.stdout.write(f"works: {case.__name__}\n")
    for line in COMMANDS:
        command(line)
        sys.stdout.write(f"works: {line.split()[0]}\n")
    sys.stdout.write(f"modules: {' '.join(k for k, v in sys.modules.items() if v)}\n")
