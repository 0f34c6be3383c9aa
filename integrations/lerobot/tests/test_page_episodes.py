"""LeRobot reads and replays episodes that the page recorded while a hand moved the tip."""

import itertools
import json
import time

import numpy as np
import pytest
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from served import Watch, distance_m, run, served

import ikservo
from ikservo.apps.page.messages.page_messages import read_message
from ikservo.apps.page.page_app import ViewApp
from ikservo.apps.page.panels.episode_panel import FPS, EpisodeFolder
from ikservo.apps.page.served_arms import ArmAtPort
from ikservo.apps.page.server.auth import Permission
from ikservo.apps.teaching.dataset_reading import read_dataset
from ikservo.apps.teaching.lerobot_values import JointValues

ARMS = ("so101", "koch", "omx_f", "wx250s")
CIRCLE_M, LAP_S, LAPS = 0.02, 2.5, 3  # 50 mm/s; a larger circle meets a limit of the SO-101's wrist
RAISE_M = 0.02  # away from contacts of the pose in which the arm begins
RATE_HZ = 60.0
NEAR_M = 2e-3


class Hand:
    """A page's messages from a hand that moves the tip."""

    def __init__(self, served_arm):
        self._controller, self._numbers = served_arm.controller, itertools.count(1)
        self._thread, self._client = served_arm.arm_thread, None
        self._client = self._controller.connect(Permission.CONTROL)
        self.episode = {}

    def send(self, **words):
        text = json.dumps({**words, "seq": next(self._numbers), "seen": 0})
        self._controller.receive(self._client, read_message(text))

    def look(self):
        for frame in self._controller.frames(self._client):
            if frame["kind"] == "episode":
                self.episode = frame

    def until(self, is_true):
        end_s = time.monotonic() + 30.0
        while not is_true():
            assert time.monotonic() < end_s, self.episode
            self.send(kind="heartbeat", visible=True)
            self.look()
            time.sleep(0.02)

    def raise_tip(self, clutch):
        self.move([[0.0, 0.0, RAISE_M * k / RATE_HZ] for k in range(int(RATE_HZ))], clutch)

    def draw_circles(self, clutch):
        angles = 2 * np.pi * np.arange(RATE_HZ * LAP_S * LAPS) / (RATE_HZ * LAP_S)
        circle = np.stack([0.0 * angles, np.sin(angles), 1.0 - np.cos(angles)], axis=1)
        self.move(CIRCLE_M * circle, clutch)

    def move(self, shifts_m, clutch):
        """Hold the clutch and move the hand through displacements (k, 3), 60 per second."""
        start_s = time.monotonic()
        for step, shift_m in enumerate(np.asarray(shifts_m)):
            self.send(kind="track_hand", position=shift_m.tolist(), rotation=[1.0, 0.0, 0.0, 0.0],
                      held=True, clutch=clutch)  # fmt: skip
            self.send(kind="heartbeat", visible=True)
            self.look()
            time.sleep(max(0.0, start_s + (step + 1) / RATE_HZ - time.monotonic()))
        self.send(kind="track_hand", position=[0.0] * 3, rotation=[1.0, 0.0, 0.0, 0.0], held=False,
                  clutch=clutch)  # fmt: skip


def record_circles(name, folder, episodes):
    """Record episodes of an arm whose tip a hand moves; return the data set."""
    place = ArmAtPort(ikservo.load_model(name), "sim:?pose=home")
    recording = EpisodeFolder(folder, "circles")
    app = ViewApp([place], dead_man_s=5.0, cameras=["sim"], record=recording)
    with app:
        arm = app.arms.find("")
        hand = Hand(arm)
        hand.send(kind="set_speed", name="fast")
        hand.send(kind="set_live", on=True)
        hand.until(lambda: arm.arm_thread.snapshot.reference is not None)
        hand.raise_tip(1)
        for number in range(episodes):
            hand.send(kind="record_episode", action="begin")
            hand.until(lambda: hand.episode.get("seconds"))  # the camera delivers pictures
            hand.draw_circles(number + 2)
            hand.send(kind="record_episode", action="save")
            hand.until(lambda n=number: hand.episode.get("episodes") == n + 1)
    return folder


@pytest.mark.parametrize("name", ARMS)
def test_episode_of_the_page_is_read_and_replayed_by_lerobot(name, tmp_path):
    folder = record_circles(name, tmp_path / "circles", episodes=2)
    read = LeRobotDataset("me/circles", root=folder)
    frame = read[len(read) - 1]
    assert (read.num_episodes, read.fps, frame["task"]) == (2, FPS, "circles")
    assert frame["observation.images.camera_sim"].shape[0] == 3
    model = ikservo.load_model(name)
    dataset = read_dataset(folder)
    values = JointValues(model)
    at = [values.names.index(joint) for joint in model.chain.names]
    positions = values.rows_to_positions(dataset.episodes[1].values)
    wanted = np.array([model.chain.forward(row[at])[:3, 3] for row in positions])
    assert np.ptp(wanted, axis=0).max() > 1.5 * CIRCLE_M
    options = ["--pose", "home"]
    with served(tmp_path, "follower", *options, model=name) as follower:
        with ikservo.open_arm(name, port=str(follower.port)) as arm:
            arm.pose("home")
            arm.move_joints(positions[0])
        with Watch(follower) as watch:
            run(tmp_path, "lerobot-replay", "--robot.type=ikservo", f"--robot.arm={name}",
                f"--robot.port={follower.port}", "--robot.id=black",
                "--dataset.repo_id=me/circles", f"--dataset.root={folder}",
                "--dataset.episode=1", "--play_sounds=false")  # fmt: skip
    error_m = distance_m(wanted, watch.path_m)
    print(f"{name}: {len(wanted)} frames, at most {error_m.max() * 1000:.2f} mm")
    assert error_m.max() < NEAR_M
