"""Every command that moves an arm accepts obstacles with ``--scene``."""

import json
import math
import re

import pytest

import ikservo
from ikservo.apps.teaching.recorder import recording_header
from ikservo.apps.teaching.recording import RecordingWriter

WALL = """
[[box]]
name = "the wall"
center_m = [0.1, -0.15, 0.15]
size_m = [0.2, 0.02, 0.3]
"""


@pytest.fixture
def recorded(tmp_path):
    """Return a recording in which the pan turns by 80 degrees from the pose home."""
    model = ikservo.load_model("so101")
    path = tmp_path / "turn.jsonl"
    with RecordingWriter(path, recording_header(model, 0.5)) as writer:
        for k in range(9):
            turned = {**model.pose("home"), "shoulder_pan": math.radians(10.0 * k)}
            writer.write(0.5 * k, [turned[joint.name] for joint in model.joints])
    return path


def test_replay_through_scene_object_is_refused(run_cli, tmp_path, recorded):
    scene = tmp_path / "scene.toml"
    scene.write_text(WALL)
    command = f"replay {recorded} --arm so101 --port sim:?pose=home --yes"
    refused = run_cli(f"{command} --scene {scene}")
    assert refused.code == 8, refused.err
    assert "the wall" in refused.err
    assert run_cli(f"{command} --dry-run").code == 0


@pytest.mark.parametrize(
    "command",
    [
        "replay {file}",
        "program run {file}",
        "jog +x --duration 1",
        "gripper close",
        "serve so101",
        "joints a=1",
    ],
)
def test_command_with_scene_option_reads_the_scene_file(run_cli, tmp_path, recorded, command):
    file = recorded
    if "program" in command:
        file = tmp_path / "tea.toml"
        assert run_cli(f"program new {file} --arm so101").code == 0
    arm = "" if "serve" in command else "--arm so101"
    done = run_cli(f"{command.format(file=file)} {arm} --port sim --scene {tmp_path}/none.toml")
    assert "none.toml" in done.err
    assert done.code not in (0, 1)


def test_gripper_width_error_suggests_working_joints_command(run_cli):
    refused = run_cli("gripper 30mm --arm so101 --port sim --yes")
    assert refused.code == 2
    hint = re.search(r"ikservo (joints \S+=[-0-9.]+)", refused.err)
    done = run_cli(f"{hint[1]} --arm so101 --port sim --yes --json")
    assert done.code == 0
    assert json.loads(done.out)["reached"]
