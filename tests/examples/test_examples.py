"""Every example runs unchanged in this process, and prints the expected output."""

import re
import runpy
from pathlib import Path

import pytest

import servosim
from tests.apps.remote.conftest import TIMEOUT_S, find_free_port, serve
from tests.cli.fixtures_ports import run_command

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"
pytestmark = pytest.mark.timeout(600)  # of a busy machine
PRINTED = {  # the line that tells that it worked
    "move": r"error +0\.\d\d mm",
    "draw_circle": r"largest distance from the circle +[0-2]\.\d\d mm",
    "pick_and_place": r"close: grasped False, the gripper is at -10°\n"
    r"open: grasped False, the gripper is at 100°",
    "camera_pick": r"the red block is at \(2\d\d, \d+\) mm\ngrasped: True",
    "stream": r"150 goals sent, 0 refused",
    "follow_hand": r"\d{3} goals, 0 refused, up by (39|40|41) mm",
    "several_arms": r"reached: True, [\d.]+ s\nreached: True, [\d.]+ s",
    "own_arm": r"reached: True, error 0\.000 mm\nmeasured error 0\.\d\d mm",
    "batch_ik": r"9\d % of the points can be reached",
    "plot_workspace": r"workspace\.png: \d{3} of 868 points can be reached",
    "record_and_replay": r"2\d samples in 0\.50 s\nreplayed in",
    "network": r"reached: True",
}


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """Return a function that runs an example in an empty folder and returns its output."""
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path)

    def run(name, *args):
        monkeypatch.setattr("sys.argv", [name, *args])
        runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
        return capsys.readouterr().out

    return run


def test_every_example_is_tested_and_listed():
    names = {path.stem for path in EXAMPLES.glob("*.py")}
    page = (ROOT / "docs/how-to/examples.md").read_text("utf-8")
    assert names == set(PRINTED) == set(re.findall(r"^\| `(\w+)\.py` \|", page, re.M))


@pytest.mark.parametrize("name", sorted(set(PRINTED) - {"network", "camera_pick"}))
def test_example_runs_and_prints_its_documented_output(run, name, tmp_path):
    assert re.search(PRINTED[name], run(name))
    pictures = {path.name: path.read_bytes()[:4] for path in tmp_path.glob("*.png")}
    assert pictures == ({"workspace.png": b"\x89PNG"} if name == "plot_workspace" else {})


@pytest.mark.campaign
def test_camera_pick_example_calibrates_and_lifts_cube(run, monkeypatch, tmp_path):
    pytest.importorskip("cv2")
    ports, open_camera = [], servosim.open_camera

    def open_and_keep(port, board):
        ports.append(port)
        camera = open_camera(port, board)
        if camera.hint:
            pytest.skip(camera.hint)
        return camera

    monkeypatch.setattr(servosim, "open_camera", open_and_keep)
    assert run_command("camera board board.svg").code == 0
    assert (tmp_path / "board.svg").stat().st_size > 5000
    words = "calibrate so101 --camera sim --port sim:?pose=home --pictures 14 --yes --json"
    done = run_command(words)
    assert done.code == 0, done.err
    assert done.json["after_m"] < 0.001
    assert re.search(PRINTED["camera_pick"], run("camera_pick"))
    ((_, _, height_m),) = [T[:3, 3] for T in ports[-1].line.world.cube_poses()]
    assert height_m > 0.06  # the simulator says that it is lifted


def test_network_example_moves_served_arm(run, monkeypatch):
    monkeypatch.setattr("ikservo.apps.remote.client_connection._MAX_ROUND_TRIP_S", TIMEOUT_S)
    with serve(find_free_port()) as served:
        served.server.lease.timeout_s = TIMEOUT_S
        assert re.search(PRINTED["network"], run("network", served.address))
        assert abs(served.arm.where().positions["wrist_roll"] - 0.2) < 0.02


def test_examples_have_at_most_40_lines():
    long = {path.name for path in EXAMPLES.glob("*.py") if len(path.read_text().splitlines()) > 40}
    assert long == set()
