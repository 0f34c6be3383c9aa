"""Obstacles around an arm are added, changed, dragged, removed and saved on its page."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from ikservo.apps.page.dragging.goal_planning import PlanRequest
from ikservo.apps.page.messages import thing_messages as things
from ikservo.apps.page.messages.page_messages import BadMessageError, SetLive
from ikservo.apps.page.served_arms import ArmAtPort, ServedArms, ViewSettings
from ikservo.apps.page.server.auth import Permission
from ikservo.apps.page.server.downloads import DownloadOffers
from ikservo.arm import open_arm
from ikservo.clock import RealClock
from ikservo.errors import BadValueError, CollisionError, NoPortError
from ikservo.model import load_model
from ikservo.model.scene_file import PlacedArm, read_scene, read_scene_with_arms
from tests.apps.page.view_session import ViewSession
from tests.browser.page_operator import until

DRAG_PX = 60.0


@pytest.fixture
def session():
    with ViewSession() as made:
        yield made


def shown(session, client=None):
    """Return the things that are sent to a client, by name."""
    frame = session.latest_frames(client).get("things", {"things": []})
    return {each["name"]: each for each in frame["things"]}


def test_page_adds_changes_renames_and_removes_scene_object(session):
    session.latest_frames()
    session.send_message(things.AddThing, shape="box")
    assert set(shown(session)) == {"the box 1"}
    session.send_message(things.ChangeThing, name="the box 1", center_m=(0.2, 0.15, 0.12))
    session.send_message(
        things.ChangeThing, name="the box 1", new_name="the shelf", size_m=(0.1, 0.1, 0.02)
    )
    (shelf,) = shown(session).values()
    assert shelf["name"] == "the shelf"
    assert shelf["half"] == pytest.approx((0.05, 0.05, 0.01))
    assert shelf["sizes"]["center_m"] == pytest.approx((0.2, 0.15, 0.12))
    with pytest.raises(CollisionError, match="the shelf"):
        session.arm.plan_to((0.2, 0.15, 0.12), straight=True)
    session.send_message(things.RemoveThing, name="the shelf")
    assert session.arm.scene.names == ()
    assert session.arm.plan_to((0.2, 0.15, 0.12), straight=True).solution.reached


@pytest.mark.parametrize("shape", ["box", "cylinder", "sphere"])
def test_new_scene_objects_have_unique_names_and_are_free(session, shape):
    for _ in range(2):
        session.send_message(things.AddThing, shape=shape)
    first, second = session.arm.scene.names
    assert first[:-1] == second[:-1]
    assert session.arm.clearance_m(session.arm.where().positions) > 0.0


@pytest.mark.parametrize("start", ["home", "rest"])
@pytest.mark.parametrize("name", ["so101", pytest.param("wx250s", marks=pytest.mark.full)])
def test_new_scene_objects_are_placed_apart_in_front_of_arm(name, start):
    with ViewSession(open_arm(name, f"sim:?pose={start}")) as session:
        home = dict(session.arm.model.pose("home"))
        front_m = session.arm.chain.forward(
            np.array([home[joint] for joint in session.arm.chain.names])
        )[:2, 3]
        for _ in range(3):
            session.send_message(things.AddThing, shape="box")
        centres = [np.array(each.row[9:12]) for each in session.arm.scene.things]
        for centre in centres:
            assert centre[:2] @ front_m > 0.2 * np.linalg.norm(centre[:2]) * np.linalg.norm(front_m)
        for one, other in itertools.combinations(centres, 2):
            assert np.abs(one - other).max() > 0.06
        assert session.arm.plan_to(centres[0] + [0, 0, 0.08]).solution.reached


def test_number_of_scene_objects_is_limited_to_100(session):
    session.send_message(things.AddThing, shape="sphere")
    (ball,) = session.arm.scene.things
    more = {f"ball {i}": replace(ball, name=f"ball {i}") for i in range(100)}
    session.arm.scene._change(more, {})
    with pytest.raises(BadMessageError, match="fewer than 100"):
        session.send_message(things.AddThing, shape="sphere")


def test_unchanged_scene_objects_are_sent_to_page_once(session):
    session.send_message(things.AddThing, shape="sphere")
    assert shown(session)
    assert "things" not in session.latest_frames()
    watcher = session.connect(Permission.WATCH)
    assert shown(session, watcher)


@pytest.mark.parametrize(
    ("message", "fields", "sentence"),
    [
        (things.ChangeThing, {"name": "the cup", "radius_m": 0.1}, "no thing named 'the cup'"),
        (things.ChangeThing, {"name": "the ball 1", "radius_m": -0.1}, "radius_m"),
        (things.ChangeThing, {"name": "the ball 1", "size_m": (0.1, 0.1, 0.1)}, "size_m"),
        (things.ChangeThing, {"name": "the ball 1", "new_name": "base"}, "unused name"),
        (things.ChangeThing, {"name": "the ball 1", "new_name": "a\nb"}, "name"),
        (things.RemoveThing, {"name": "the cup"}, "no thing named 'the cup'"),
    ],
)
def test_invalid_change_of_scene_object_is_refused(session, message, fields, sentence):
    session.send_message(things.AddThing, shape="sphere")
    (before,) = session.arm.scene.things
    with pytest.raises(BadMessageError, match=sentence):
        session.send_message(message, **fields)
    assert session.arm.scene.things == (before,)


def test_scene_cannot_change_in_live_mode_or_by_watcher(session):
    watcher = session.connect(Permission.WATCH)
    with pytest.raises(BadMessageError, match="can only watch"):
        session.send_message(things.AddThing, watcher, shape="box")
    session.enable_live()
    with pytest.raises(BadMessageError, match="Things cannot be changed while the arm follows"):
        session.send_message(things.AddThing, shape="box")
    assert session.arm.scene.names == ()


def test_dragged_scene_object_moves_when_dropped(session):
    session.send_message(things.AddThing, shape="box")
    session.send_message(things.ChangeThing, name="the box 1", center_m=(0.1, 0.25, 0.03))
    at = session.camera().project(np.array([0.1, 0.25, 0.03]))[0].tolist()
    session.point("down", *at)
    for part in (0.5, 1.0):
        session.point("move", at[0] + part * DRAG_PX, at[1])
    before_m = np.reshape(shown(session)["the box 1"]["pose"], (4, 4))[:3, 3]
    (stands,) = session.arm.scene.things
    assert np.linalg.norm(before_m - stands.row[9:12]) > 0.02  # drawn there, not moved yet
    session.point("up", at[0] + DRAG_PX, at[1])
    (moved,) = session.arm.scene.things
    np.testing.assert_allclose(moved.row[9:12], before_m, atol=1e-9)
    session.point("hover", *at)
    assert session.arm.scene.things == (moved,)


def test_scene_objects_are_saved_as_scene_file(session, tmp_path):
    for shape in ("box", "cylinder", "sphere"):
        session.send_message(things.AddThing, shape=shape)
    session.send_message(things.SaveThings)
    offer = session.latest_frames()["download"]
    assert offer["name"] == "scene.toml"
    (download,) = [each for _, each in session.controller.downloads._offers.values()]
    (tmp_path / "scene.toml").write_text("".join(download.make()), encoding="utf-8")
    assert [each.name for each in read_scene(tmp_path / "scene.toml")] == list(
        session.arm.scene.names
    )


class Table:
    """Two arms on one table, each with a client in control."""

    def __init__(self, ports=("sim:?pose=home", "sim:?pose=home"), beside=()):
        clock, self.seq = RealClock(), 0
        self.arms = ServedArms(ViewSettings(open_arm, clock, DownloadOffers(clock), 60.0))
        so101 = ArmAtPort(load_model("so101"), ports[0], tuple(beside))
        self.arms.open_all([so101, ArmAtPort(load_model("koch"), ports[1])])
        self.clients = {each.name: each.connect(Permission.CONTROL) for each in self.arms.all()}

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.arms.close()

    def scene(self, name):
        return self.arms.find(name).arm_thread.arm.scene

    def send(self, of, kind, /, **fields):
        self.seq += 1
        word = kind.model_fields["kind"].annotation.__args__[0]
        message = kind(kind=word, seq=self.seq, seen=0, **fields)
        self.arms.find(of).receive(self.clients[of], message)

    def shown(self, name):
        frames = self.arms.find(name).frames(self.clients[name])
        return next(each for each in frames if each["kind"] == "things")


def test_second_arm_of_page_is_placed_drawn_and_saved(tmp_path):
    with Table() as table:
        table.send("so101", things.AddArm, name="koch")
        table.send("so101", things.ChangeThing, name="koch", at_m=(0.45, None, None))
        frame = table.shown("so101")
        (row,) = frame["things"]
        assert (row["name"], row["thing"], row["drawn"]) == ("koch", "arm", False)
        assert row["sizes"]["at_m"] == pytest.approx((0.45, 0.0, 0.0))
        assert "koch's gripper" in {each["name"] for each in frame["links"]}
        tips = [np.reshape(each["pose"], (4, 4))[0, 3] for each in frame["links"]]
        assert min(tips) < 0.36  # it faces this arm
        assert max(tips) < 0.48
        assert [each["name"] for each in table.shown("koch")["things"]] == ["so101"]
        table.send("so101", things.SaveThings)
        offers = table.arms.find("so101").controller.downloads._offers
        (text,) = ["".join(each.make()) for _, each in offers.values()]
        (tmp_path / "scene.toml").write_text(text, encoding="utf-8")
        (arm,) = read_scene_with_arms(tmp_path / "scene.toml")[1]
        assert (arm.name, arm.at_m) == ("koch", pytest.approx((0.45, 0.0, 0.0)))
        table.send("koch", things.RemoveThing, name="so101")
        assert table.scene("so101").names == ()


def test_only_other_resting_arm_can_be_placed_in_scene():
    with Table() as table:
        for name in ("so101", "px150"):
            with pytest.raises(BadMessageError, match="No other arm"):
                table.send("so101", things.AddArm, name=name)
        table.send("koch", SetLive, on=True)
        with pytest.raises(BadMessageError, match="koch is moving"):
            table.send("so101", things.AddArm, name="koch")
        assert table.scene("so101").names == ()


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_placed_arms_stay_obstacles_after_reopening():
    beside = [PlacedArm("koch", (0.45, 0.0, 0.0), (0.0, 0.0, 180.0))]
    with Table(beside=beside) as table:
        arm = table.arms.find("so101").arm_thread.arm
        assert (arm.scene.names, table.scene("koch").names) == (("koch",), ("so101",))
        (before,) = arm.scene.arms
        goal, start = np.ones(6), np.zeros(6)
        planned = PlanRequest(arm, goal, start, "slow")
        with table.arms.find("koch").arm_thread.arm.context.surroundings.in_turn():
            now = PlanRequest(arm, goal, start, "slow")
            assert now.change_since(planned) == "The things around the arm have changed"
        assert PlanRequest(arm, goal, start, "slow").change_since(planned) == ""
        table.arms.start_closing("koch")
        until(lambda: len(table.arms.all()) == 1)
        assert before.left
        assert table.shown("so101")["links"]
        table.arms.start_opening(ArmAtPort(load_model("koch"), "/dev/ttyNOTHERE"))
        until(lambda: len(table.arms.all()) == 2 and table.arms.all()[1].error)
        table.arms.start_closing("koch")
        until(lambda: len(table.arms.all()) == 1)
        table.arms.start_opening(ArmAtPort(load_model("koch"), "sim:?pose=rest"))
        until(lambda: table.arms.find("koch"))
        assert table.scene("koch").names == ("so101",)
        (now,) = arm.scene.arms
        assert now.left is None
        np.testing.assert_array_equal(now.T_base_other, before.T_base_other)


@pytest.mark.parametrize(
    ("ports", "beside", "error"),
    [
        (("sim:?pose=home", "/dev/ttyNOTHERE"), PlacedArm("koch", (0.4, 0.0, 0.0)), NoPortError),
        (("sim:?pose=home",) * 2, PlacedArm("koch", (0.0, 0.0, 0.0)), BadValueError),
    ],
)
def test_page_refuses_arm_that_cannot_be_obstacle(ports, beside, error):
    with pytest.raises(error):
        Table(ports, [beside])
