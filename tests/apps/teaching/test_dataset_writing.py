"""Episodes with pictures are added to a data set, which is continued later or refused."""

import json
import os
import shutil

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import ikservo
from ikservo.apps.page.panels.episode_panel import (
    FPS,
    EpisodeSample,
    StoredPictures,
    camera_feature,
    resample,
)
from ikservo.apps.teaching.dataset_reading import read_dataset
from ikservo.apps.teaching.dataset_writing import DatasetWriter, NewEpisode
from ikservo.apps.teaching.lerobot_values import JointValues
from ikservo.errors import FileFormatError, InputError
from ikservo.files.writing import FileWriteError

MODEL = ikservo.load_model("so101")
WIDTH, HEIGHT = 32, 24


def jpeg(level, width=WIDTH):
    red = np.zeros((HEIGHT, width, 3), np.uint8)
    red[..., 2] = level  # OpenCV stores blue first
    return cv2.imencode(".jpg", red)[1].tobytes()


def episode(count, value=0.0, levels=None, width=WIDTH):
    rows = value + np.tile(np.arange(count, dtype=float)[:, None], (1, len(MODEL.joints)))
    levels = levels or [200] * count
    return NewEpisode(rows, rows + 1.0, {"left": lambda frame: jpeg(levels[frame], width)})


def writer(folder, **changes):
    given = {"model": MODEL, "fps": 30, "task": "stack", "cameras": ["left"], **changes}
    return DatasetWriter(folder, **given)


def info_of(folder):
    return json.loads((folder / "meta" / "info.json").read_text())


def statistics_of(folder):
    return json.loads((folder / "meta" / "stats.json").read_text())


def test_new_data_set_has_pictures_and_their_description(tmp_path):
    folder = tmp_path / "set"
    writer(folder).add([episode(5)])
    info = info_of(folder)
    assert info["features"]["observation.images.left"] == {
        "dtype": "image", "shape": [HEIGHT, WIDTH, 3], "names": ["height", "width", "channels"],
    }  # fmt: skip
    table = pq.read_table(folder / "data" / "chunk-000" / "file-000.parquet")
    stored = table.column("observation.images.left").to_pylist()
    assert [each["bytes"] for each in stored] == [jpeg(200)] * 5
    means = np.ravel(statistics_of(folder)["observation.images.left"]["mean"])
    np.testing.assert_allclose(means, [200 / 255, 0, 0], atol=0.02)  # red first


def test_data_set_is_continued_with_another_task(tmp_path):
    folder = tmp_path / "set"
    first = writer(folder)
    first.add([episode(5)])
    first.add([episode(4, 10.0)])
    again = writer(folder, task="sort")
    assert (again.episodes, again.frames) == (2, 9)
    again.add([episode(3, 20.0)])
    assert info_of(folder)["splits"] == {"train": "0:3"}
    assert (info_of(folder)["total_frames"], info_of(folder)["total_tasks"]) == (12, 2)
    files = sorted(path.name for path in (folder / "data" / "chunk-000").iterdir())
    assert files == ["file-000.parquet", "file-001.parquet", "file-002.parquet"]
    read = read_dataset(folder)
    assert [each.values[0, 0] for each in read.episodes] == [0.0, 10.0, 20.0]
    table = pq.read_table(folder / "data" / "chunk-000" / "file-002.parquet")
    assert table.column("index").to_pylist() == [9, 10, 11]
    assert table.column("task_index").to_pylist() == [1, 1, 1]


def test_combined_statistics_are_those_of_all_frames(tmp_path):
    folder = tmp_path / "set"
    added = writer(folder)
    parts = [episode(50, 3.0), episode(20, -7.0)]
    for each in parts:
        added.add([each])
    whole = np.concatenate([each.action for each in parts])
    found = statistics_of(folder)["action"]
    for name, wanted in {"min": whole.min(0), "max": whole.max(0), "mean": whole.mean(0),
                         "std": whole.std(0)}.items():  # fmt: skip
        np.testing.assert_allclose(found[name], wanted, err_msg=name)
    assert found["count"] == [70]


def test_changed_data_set_is_not_overwritten(tmp_path):
    folder = tmp_path / "set"
    first = writer(folder)
    first.add([episode(5)])
    second = writer(folder)
    second.add([episode(6)])
    with pytest.raises(InputError, match="was changed meanwhile"):
        first.add([episode(7)])
    shutil.rmtree(folder)
    with pytest.raises(InputError, match="was changed meanwhile"):
        second.add([episode(7)])
    assert not folder.exists()


@pytest.mark.parametrize("killed_before", range(1, 6))
def test_data_set_is_continued_after_a_kill_while_saving(tmp_path, monkeypatch, killed_before):
    folder, renamed, replace = tmp_path / "set", [], os.replace
    added = writer(folder)
    added.add([episode(5)])

    def kill(*names):
        renamed.append(names)
        if len(renamed) > killed_before:
            raise KeyboardInterrupt
        replace(*names)

    monkeypatch.setattr(os, "replace", kill)
    with pytest.raises(KeyboardInterrupt):
        added.add([episode(6)])
    monkeypatch.undo()
    continued = writer(folder)
    assert continued.episodes == 1
    continued.add([episode(7, 20.0)])
    read = read_dataset(folder)
    assert [len(each.times_s) for each in read.episodes] == [5, 7]
    assert read.episodes[1].values[0, 0] == 20.0


def test_data_set_from_which_lerobot_deleted_is_continued(tmp_path):
    folder = tmp_path / "set"
    writer(folder).add([episode(5)])
    path = folder / "meta" / "tasks.parquet"
    row = {"task_index": 0, "__index_level_0__": "stack"}  # as pandas writes it
    pq.write_table(pa.Table.from_pylist([row]), path)
    again = writer(folder)
    again.add([episode(6)])
    assert pq.read_table(path).column("task").to_pylist() == ["stack"]


def forget_the_rate(folder):
    info = info_of(folder)
    del info["fps"]
    (folder / "meta" / "info.json").write_text(json.dumps(info))


def remove_an_episode(folder):
    path = folder / "meta" / "episodes" / "chunk-000" / "file-000.parquet"
    pq.write_table(pa.Table.from_pylist(pq.read_table(path).to_pylist()[:1]), path)


def cut_the_episodes(folder):
    path = folder / "meta" / "episodes" / "chunk-000" / "file-000.parquet"
    path.write_bytes(path.read_bytes()[:100])


@pytest.mark.parametrize("spoil", [forget_the_rate, remove_an_episode, cut_the_episodes])
def test_damaged_data_set_is_not_continued(tmp_path, spoil):
    folder = tmp_path / "set"
    started = writer(folder)
    started.add([episode(5)])
    started.add([episode(5)])
    spoil(folder)
    with pytest.raises(FileFormatError, match="cannot be continued"):
        writer(folder)


@pytest.mark.parametrize(
    "changes",
    [
        {"model": ikservo.load_model("koch")},  # with the same joints
        {"model": ikservo.load_model("px100")},
        {"fps": 15},
        {"cameras": ["left", "top"]},
        {"cameras": []},
    ],
    ids=["another arm", "other joints", "another rate", "one camera more", "no camera"],
)
def test_data_set_of_another_arm_or_rate_is_not_continued(tmp_path, changes):
    folder = tmp_path / "set"
    writer(folder).add([episode(5)])
    with pytest.raises(FileFormatError, match="cannot be continued"):
        writer(folder, **changes)


def test_pictures_of_another_size_are_refused(tmp_path):
    folder = tmp_path / "set"
    added = writer(folder)
    added.add([episode(5)])
    with pytest.raises(InputError, match="another size"):
        added.add([episode(5, width=64)])
    assert len(read_dataset(folder).episodes) == 1


def test_folder_with_other_files_is_refused(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(InputError, match="not a data set"):
        writer(tmp_path)


def test_data_set_is_as_before_if_an_episode_cannot_be_written(tmp_path, monkeypatch):
    folder = tmp_path / "set"
    added = writer(folder)
    added.add([episode(5)])

    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("ikservo.files.writing._write_beside", fail)
    with pytest.raises(FileWriteError):
        added.add([episode(6)])
    monkeypatch.undo()
    assert writer(folder).frames == 5
    added.add([episode(6)])
    assert [len(each.times_s) for each in read_dataset(folder).episodes] == [5, 6]


class Numbers:
    """Pictures whose data are their numbers."""

    def read(self, number):
        return number


def samples(times_s, delays_s, set_points):
    """Return samples of joints that move at 1 rad/s from 0."""
    joints = len(MODEL.joints)
    return [
        EpisodeSample(at_s, at_s - delay_s, np.full(joints, at_s - delay_s),
                      None if goal is None else np.full(joints, goal), (number,))
        for number, (at_s, delay_s, goal) in
        enumerate(zip(times_s, delays_s, set_points, strict=True))
    ]  # fmt: skip


def test_joints_are_interpolated_between_their_readings():
    rng = np.random.default_rng(5)
    times_s = np.cumsum(rng.uniform(0.02, 0.05, 200))
    found = resample(samples(times_s, rng.uniform(0, 0.015, 200), [0.5] * 200), JointValues(MODEL))
    frames_s = times_s[0] + np.arange(len(found.state)) / FPS
    positions = JointValues(MODEL).rows_to_positions(found.state)
    np.testing.assert_allclose(positions[1:-2, 0], frames_s[1:-2], atol=1e-6)
    assert len(found.state) == 1 + round((times_s[-1] - times_s[0]) * FPS)


def test_action_is_set_point_or_next_joints_of_a_limp_arm():
    times_s = np.arange(60) / FPS
    references = [7.0] * 30 + [None] * 30
    found = resample(samples(times_s, [0.0] * 60, references), JointValues(MODEL))
    action = JointValues(MODEL).rows_to_positions(found.action)[:, 0]
    np.testing.assert_allclose(action[:30], 7.0)
    np.testing.assert_allclose(action[30:-1], times_s[31:], atol=1e-6)


def test_frame_has_the_picture_of_the_nearest_sample():
    rng = np.random.default_rng(3)
    late_s = np.concatenate([[0.0], rng.uniform(1e-4, 1e-3, 299)])  # as a thread wakes up
    times_s = np.arange(300) / FPS + late_s
    found = resample(samples(times_s, [0.0] * 300, [0.0] * 300), JointValues(MODEL),
                     {"left": Numbers()})  # fmt: skip
    assert [found.pictures["left"](k) for k in range(len(found.state))] == list(range(300))


def test_pictures_are_read_back_as_they_were_stored(tmp_path):
    stored = StoredPictures(tmp_path)
    numbers = [stored.append(bytes([k]) * (k + 1)) for k in range(9)]
    assert [stored.read(k) for k in reversed(numbers)] == [bytes([k]) * (k + 1)
                                                           for k in reversed(range(9))]  # fmt: skip
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("title", "name"), [("camera 0", "camera_0"), ("left", "left"), ("…", "camera")]
)
def test_camera_has_a_name_that_a_column_can_have(title, name):
    assert camera_feature(title) == name
