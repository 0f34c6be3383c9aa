"""``ikservo export dataset`` and ``ikservo import dataset``: LeRobot's episodes, both ways."""

import importlib.util
import json
import math

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import ikservo
from ikservo.apps.teaching.recorder import recording_header
from ikservo.apps.teaching.recording import RecordingWriter
from ikservo.calibration.calibration_file import read_calibration
from ikservo.calibration.lerobot import parse_lerobot
from ikservo.remedies import install_command
from tests.arm.simulated import true_joints
from tests.calibration.lerobot_files import lerobot_text
from tests.calibration.mounted_arms import make_mounted_arm
from tests.calibration.scripted_operator import schedule_operator


@pytest.fixture
def wave(tmp_path):
    """Return a recording of the SO-101 that nods and opens its gripper, at 50 Hz."""
    model = ikservo.load_model("so101")
    home = model.pose("home")
    q = np.array([home[joint.name] for joint in model.joints])
    path = tmp_path / "wave.jsonl"
    with RecordingWriter(path, recording_header(model, 0.02)) as writer:
        for step in range(101):
            share = math.sin(math.pi * step / 100)
            writer.write(step * 0.02, q + share * np.array([0.2, 0, 0.1, 0, 0.3, 0.4]))
    return path


@pytest.fixture
def exported(wave, run_cli, tmp_path):
    """Return a data set of two episodes."""
    folder = tmp_path / "set"
    done = run_cli(f"export dataset {wave} {wave} --arm so101 --to {folder} --fps 25 --task wave")
    assert done.code == 0, done.err
    assert "2 episodes, 102 frames" in done.out
    return folder


def info_of(folder):
    return json.loads((folder / "meta" / "info.json").read_text())


def change_info(folder, **changes):
    (folder / "meta" / "info.json").write_text(json.dumps(info_of(folder) | changes))


def frames_of(folder):
    return pq.read_table(folder / "data" / "chunk-000" / "file-000.parquet")


def write_frames(folder, table):
    pq.write_table(table, folder / "data" / "chunk-000" / "file-000.parquet")


def test_exported_data_set_has_degrees_percent_and_frame_rate(exported, wave):
    table, recorded = frames_of(exported), ikservo.read_recording(wave)
    state = np.array(table.column("observation.state").to_pylist())
    names = info_of(exported)["features"]["observation.state"]["names"]
    at = names.index("wrist_roll.pos")
    assert math.radians(state[:51, at].max()) == pytest.approx(
        recorded.joints[:, 4].max(), abs=1e-3
    )
    gripper = state[:, names.index("gripper.pos")]
    assert 0.0 < gripper.min() < gripper.max() <= 100.0
    assert table.column("episode_index").to_pylist() == [0] * 51 + [1] * 51
    assert table.column("index").to_pylist() == list(range(102))
    np.testing.assert_allclose(table.column("timestamp").to_pylist()[:51], np.arange(51) / 25)


def test_exported_action_is_state_of_next_frame(exported):
    table = frames_of(exported)
    state, action = (
        np.array(table.column(name).to_pylist())[:51] for name in ("observation.state", "action")
    )
    np.testing.assert_allclose(action[:-1], state[1:])
    np.testing.assert_allclose(action[-1], state[-1])


@pytest.mark.full
def test_exported_data_set_is_imported_and_replayed(exported, wave, run_cli, tmp_path):
    done = run_cli(f"import dataset {exported} --arm so101 --to {tmp_path / 'back'} --json")
    assert done.code == 0, done.err
    report = json.loads(done.out)
    assert (report["robot_type"], report["fps"], len(report["recordings"])) == ("ikservo", 25, 2)
    recorded, back = ikservo.read_recording(wave), ikservo.read_recording(report["recordings"][1])
    np.testing.assert_allclose(back.joints, recorded.joints[::2], atol=1e-5)
    np.testing.assert_allclose(back.times_s, recorded.times_s[::2], atol=1e-5)
    rolls = []
    with ikservo.open_arm("so101", port="sim:?pose=home") as arm:
        arm.replay(
            report["recordings"][1],
            on_progress=lambda _: rolls.append(true_joints(arm)["wrist_roll"]),
        )
    assert max(rolls) == pytest.approx(back.joints[:, 4].max(), abs=0.02)
    assert rolls[-1] == pytest.approx(back.joints[-1, 4], abs=0.01)


def test_import_dataset_reads_actions_with_its_option(exported, run_cli, tmp_path):
    run_cli(f"import dataset {exported} --arm so101 --to {tmp_path} --what state")
    run_cli(f"import dataset {exported} --arm so101 --to {tmp_path / 'a'} --what action")
    state = ikservo.read_recording(tmp_path / "set-000.jsonl")
    action = ikservo.read_recording(tmp_path / "a" / "set-000.jsonl")
    np.testing.assert_allclose(action.joints[:-1], state.joints[1:], atol=1e-6)


def test_dataset_commands_overwrite_nothing(exported, wave, run_cli, tmp_path):
    assert run_cli(f"export dataset {wave} --arm so101 --to {exported}").code == 2
    (tmp_path / "back").mkdir()
    (tmp_path / "back" / "set-001.jsonl").write_text("mine")
    done = run_cli(f"import dataset {exported} --arm so101 --to {tmp_path / 'back'}")
    assert done.code == 2
    assert "set-001.jsonl exists" in done.err
    assert [path.name for path in (tmp_path / "back").iterdir()] == ["set-001.jsonl"]


def cut(folder):
    path = folder / "data" / "chunk-000" / "file-000.parquet"
    path.write_bytes(path.read_bytes()[:300])


def without_numbers(folder):
    table = frames_of(folder)
    rows = table.column("observation.state").to_pylist()
    rows[60][2] = math.nan
    at = table.column_names.index("observation.state")
    write_frames(folder, table.set_column(at, "observation.state", pa.array(rows)))


def at_one_time(folder):
    table = frames_of(folder)
    at = table.column_names.index("timestamp")
    write_frames(folder, table.set_column(at, "timestamp", pa.array([0.0] * 102)))


@pytest.mark.parametrize(
    ("spoil", "text"),
    [
        (lambda f: change_info(f, codebase_version="v2.1"), "convert_dataset_v21_to_v30"),
        (lambda f: change_info(f, fps="fast"), "frames per second"),
        (lambda f: change_info(f, features={}), "has no names"),
        (lambda f: (f / "meta" / "info.json").write_text("{"), "is not JSON"),
        (lambda f: (f / "meta" / "info.json").unlink(), "info.json"),
        (cut, "cannot be read"),
        (without_numbers, "episode 1: has values that are not numbers"),
        (at_one_time, "episode 0: has two frames with the same time"),
    ],
)
def test_damaged_data_set_is_refused_without_writing_files(
    exported, run_cli, tmp_path, spoil, text
):
    spoil(exported)
    done = run_cli(f"import dataset {exported} --arm so101 --to {tmp_path / 'back'}")
    assert done.code == 2
    assert text in done.err.replace("\n", " ")
    assert not (tmp_path / "back").exists()


def test_import_dataset_without_pyarrow_says_what_to_install(
    exported, run_cli, monkeypatch, tmp_path
):
    find = importlib.util.find_spec
    monkeypatch.setattr(
        "ikservo.apps.teaching.dataset_reading.find_spec",
        lambda n: None if n == "pyarrow" else find(n),
    )
    done = run_cli(f"import dataset {exported} --arm so101 --to {tmp_path / 'back'}")
    assert done.code == 1  # as for every extra
    assert install_command("dataset") in done.err
    done = run_cli(f"import dataset {tmp_path} --arm so101 --to {tmp_path / 'back'}")
    assert (done.code, "that contains meta and data" in done.err) == (2, True), done.err


def test_data_set_of_another_arm_is_refused(exported, wave, run_cli, tmp_path):
    done = run_cli(f"import dataset {exported} --arm px100 --to {tmp_path / 'back'}")
    assert done.code == 2
    assert "px100" in done.err
    assert run_cli(f"export dataset {wave} --arm koch --to {tmp_path / 'k'}").code == 2
    assert not (tmp_path / "k").exists()


def test_lerobot_data_set_needs_its_calibration(exported, run_cli, tmp_path):
    change_info(exported, robot_type="so101_follower")
    done = run_cli(f"import dataset {exported} --arm so101 --to {tmp_path / 'back'}")
    assert done.code == 6
    assert "--calibration" in done.err


@pytest.fixture
def mounted(monkeypatch, tmp_path, run_cli):
    """Return an arm whose calibration was imported from LeRobot, and LeRobot's file of it."""
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path / "home"))
    arm = make_mounted_arm("so101", 21, spoiled=False)

    def open_transport(port, baud_rate):
        arm.port.is_open = True
        return arm.port

    monkeypatch.setattr("ikservo.hardware.port.open_transport", open_transport)
    path = tmp_path / "black.json"
    path.write_text(lerobot_text(arm))
    with arm.open_limp() as limp_arm:
        schedule_operator(arm, limp_arm.make_subjects("home"))
    port = "--port /dev/ttyBENCH --pose home --margin 0.3 --yes"
    assert run_cli(f"import lerobot {path} --arm so101 {port}").code == 0
    return arm, path


@pytest.mark.full
@pytest.mark.sample(1)
@pytest.mark.parametrize("percent", [False, True])
def test_lerobot_values_become_calibrated_joint_positions(
    mounted, exported, run_cli, tmp_path, percent
):
    arm, path = mounted
    joints = {joint.name: joint for joint in parse_lerobot(path, path.read_text())}
    own = read_calibration(tmp_path / "home" / "arms" / "so101.toml")
    model = ikservo.load_model("so101")
    table, row = frames_of(exported), []
    ticks = {joint.name: arm.line.servos[joint.servo.id].read("present_position")
             for joint in model.joints}  # fmt: skip
    for joint in model.joints:
        low, high = joints[joint.name].range_min, joints[joint.name].range_max
        share = (ticks[joint.name] - low) / (high - low)
        degrees = (ticks[joint.name] - (low + high) / 2) * 360 / 4095
        in_percent = 100 * share if joint.role == "gripper" else 200 * share - 100
        row.append(in_percent if percent or joint.role == "gripper" else degrees)
    at = table.column_names.index("observation.state")
    write_frames(exported, table.set_column(at, "observation.state", pa.array([row] * 102)))
    change_info(exported, robot_type="so101_follower")
    words = f"import dataset {exported} --arm so101 --to {tmp_path / 'b'} --calibration {path}"
    done = run_cli(words + (" --percent" if percent else ""))
    assert done.code == 0, done.err
    back = ikservo.read_recording(tmp_path / "b" / "set-000.jsonl")
    for column, joint in enumerate(model.joints):
        expected = own.joint(joint.name).joint_map(joint.joint_map).position(ticks[joint.name])
        assert back.joints[0, column] == pytest.approx(expected, abs=1e-3), joint.name
