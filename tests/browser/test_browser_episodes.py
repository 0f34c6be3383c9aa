"""Episodes that are recorded on the page while the arm is teleoperated."""

import json

import numpy as np
import pyarrow.parquet as pq
import pytest
from playwright.sync_api import expect

from ikservo.apps.page.panels.episode_panel import FPS, EpisodeFolder
from ikservo.apps.teaching.dataset_reading import read_dataset
from ikservo.apps.teaching.lerobot_values import JointValues
from tests.browser.page_operator import Operator, serve_view

pytestmark = pytest.mark.browser

MOVED_DEG = 5.0


@pytest.fixture
def recording(browser, tmp_path):
    """Return a user in Live whose page records to a data set, and the folder of the set."""
    folder = tmp_path / "set"
    place = EpisodeFolder(folder, "wave")
    with serve_view(cameras=["sim"], record=place) as view:
        context = browser.new_context(viewport={"width": 1100, "height": 720})
        yield Operator(context.new_page(), view).enable_live().until_still(), folder
        context.close()


def record_drag(operator, move_px):
    operator.page.click("#episode-begin")
    operator.until("document.getElementById('episode').dataset.state === 'recording'")
    operator.drag(operator.tip_px(), move_px).until_moving().release().until_still()


def saved(operator, count):
    operator.page.click("#episode-save")
    expect(operator.page.locator("#episode-text")).to_contain_text(f"{count} saved")


def test_page_records_a_drag_with_pictures_as_an_episode(recording):
    operator, folder = recording
    assert operator.page.is_visible("#episode-begin")
    assert not operator.page.is_visible("#episode-save")
    record_drag(operator, (60, -40))
    saved(operator, 1)
    (episode,) = read_dataset(folder).episodes
    joints = JointValues(operator.served.arm.model)
    assert np.ptp(episode.values, axis=0).max() > MOVED_DEG
    np.testing.assert_allclose(np.diff(episode.times_s), 1 / FPS, atol=1e-4)
    names = json.loads((folder / "meta" / "info.json").read_text())["features"]["action"]["names"]
    assert tuple(names) == tuple(joints.features)
    table = pq.read_table(folder / "data" / "chunk-000" / "file-000.parquet")
    pictures = table.column("observation.images.camera_sim").to_pylist()
    assert len({each["bytes"] for each in pictures}) > 2  # the simulated camera is slow
    assert all(each["bytes"][:2] == b"\xff\xd8" for each in pictures)
    assert operator.errors == []


def test_discarded_episode_is_not_in_the_data_set(recording):
    operator, folder = recording
    record_drag(operator, (50, 0))
    operator.page.click("#episode-discard")
    operator.page.click("#episode-discard")  # sure
    operator.until("document.getElementById('episode').dataset.state === 'idle'")
    record_drag(operator, (-50, 0))
    saved(operator, 1)
    (episode,) = read_dataset(folder).episodes
    assert episode.number == 0


def test_stop_ends_an_episode_which_can_still_be_saved(recording):
    operator, folder = recording
    record_drag(operator, (50, 0))
    operator.page.keyboard.press("Escape")
    expect(operator.page.locator("#episode-text")).to_contain_text("The arm is stopped.")
    saved(operator, 1)
    assert len(read_dataset(folder).episodes) == 1
